from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.daemon import requests
from tacshade_edge.daemon.observer import FrameResult
from tacshade_edge.daemon.profiles import ActiveProfile
from tacshade_edge.daemon.references import REFERENCE_FRAMES, References
from tacshade_edge.daemon.requests import Requests
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.protocol.requests import Request, encode_reply
from tacshade_edge.reasons import Reason
from tacshade_edge.types import Calibration, Frame, Need


class Asked:
    """`Requests` on a worker whose frames the test gives by hand."""

    def __init__(self, calibration: Calibration, folder: Path) -> None:
        reconstructor = make_reconstructor(calibration, PROFILES["fast"])
        self.replies: list[dict[str, Any]] = []
        self.changes = 0
        self.records: list[Request] = []
        self.active = ActiveProfile(reconstructor, "fast", None, lambda _: None)
        self.requests = Requests(
            self.active,
            References(calibration, folder / "c.reference.npz", "left"),
            lambda request, outcome: self.replies.append(json.loads(encode_reply(request, outcome))),
            lambda: {"up": 1},
            self._changed,
            {"record": self.records.append, "stitch": self.records.append},
        )

    def _changed(self) -> None:
        self.changes += 1

    def frames(self, image: Any, count: int) -> None:
        for seq in range(count):
            frame = Frame(seq, 0, 0, image)
            reconstructor = self.active.reconstructor
            assert not isinstance(reconstructor, Reason)
            result = reconstructor.step(frame, need=self.requests.need())
            self.requests.see(FrameResult(frame, reconstructor.calibration, result))


@pytest.fixture
def asked(calibration: Calibration, tmp_path: Path) -> Asked:
    return Asked(calibration, tmp_path)


def test_status_and_profile(asked: Asked) -> None:
    asked.requests.handle(Request("status", transaction=1))
    asked.requests.handle(Request("profile", transaction="a", profile="paper"))
    asked.requests.handle(Request("profile", transaction="b", profile="slow"))
    assert asked.replies == [
        {"transaction": 1, "ok": True, "result": {"up": 1}},
        {"transaction": "a", "ok": True, "result": {"profile": "paper"}},
        {
            "transaction": "b",
            "ok": False,
            "error": "profile: found slow, expected one of paper, fast, balanced, accurate",
            "reason_code": "unknown_profile",
        },
    ]
    assert asked.active.reconstructor.profile.name == "paper"
    assert asked.changes == 1


def test_auto_needs_a_budget(asked: Asked) -> None:
    asked.requests.handle(Request("profile", transaction=1, profile="auto"))
    expected = f"one of {', '.join(PROFILES)}; the settings give no latency budget"
    assert asked.replies[0]["error"] == f"profile: found auto, expected {expected}"
    asked.active.reload("fast", 1000.0, asked.active.reconstructor.calibration)
    asked.requests.handle(Request("profile", transaction=2, profile="auto"))
    assert asked.replies[1] == {"transaction": 2, "ok": True, "result": {"profile": "accurate"}}
    asked.requests.handle(Request("profile", transaction=3, profile="slow"))
    assert asked.replies[2]["error"] == f"profile: found slow, expected one of {', '.join(PROFILES)}, auto"


def test_a_reference_is_taken_from_the_next_frames_and_used(asked: Asked, pictures: Any) -> None:
    before = asked.active.reconstructor
    asked.requests.handle(Request("reference", transaction=5))
    asked.requests.handle(Request("reference", transaction=6))
    assert asked.requests.need() == Need.DEPTH
    assert asked.replies == [
        {"transaction": 6, "ok": False, "error": "busy: already taking a reference", "reason_code": "busy"}
    ]
    asked.frames(pictures.free, REFERENCE_FRAMES - 1)
    asked.requests.poll()
    assert len(asked.replies) == 1
    asked.frames(pictures.free, 1)
    asked.requests.poll()
    assert asked.replies[1]["ok"] is True
    assert asked.replies[1]["result"]["stored"] is True
    assert asked.replies[1]["result"]["calibration_crc32"] == asked.active.reconstructor.calibration.crc32
    assert asked.active.reconstructor is not before
    assert (asked.changes, asked.requests.need()) == (1, Need.CONTACT)
    asked.requests.poll()
    assert len(asked.replies) == 2


def test_a_touched_sensor_or_no_frames_leave_the_old_reference(
    asked: Asked, pictures: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = asked.active.reconstructor
    asked.requests.handle(Request("reference"))
    asked.frames(pictures.touched, 1)
    asked.requests.poll()
    assert "found a contact" in asked.replies[0]["error"]
    monkeypatch.setattr(requests, "REFERENCE_TIMEOUT_S", 0.0)
    asked.requests.handle(Request("reference"))
    asked.requests.poll()
    assert asked.replies[1]["error"] == "received fewer than 10 frames within 0 s"
    assert asked.active.reconstructor is before
    assert asked.changes == 0
