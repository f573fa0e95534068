"""Requests to the daemon in this process, the reference that they take or that follows,
and the profile.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Iterator
from dataclasses import replace
from itertools import count, groupby
from typing import Any

import numpy as np
import pytest

from support.calibrated_sensor import HALF, calibrated, pressed, simulated
from support.patience import wait_until
from support.running_app import BASE, Live, assert_accounted, paced, switched
from tacshade_edge.calibration.files import calibration_file, reference_file
from tacshade_edge.daemon import active_profile
from tacshade_edge.pipeline.ledger import FrameLedger
from tacshade_edge.sensor.contact import untouched
from tacshade_edge.sensor.profiles import LADDER, PROFILES
from tacshade_edge.wire import binary

pytestmark = pytest.mark.broker


def test_requests(live: Live, pictures: Any, scripted: Any) -> None:
    touch = threading.Event()
    with live.run(scripted(switched(pictures, touch))):
        wait_until(lambda: "online" in live.states() and live.payloads("health"), 10, "online")
        status = live.ask("status")
        assert (status["ok"], status["result"]["source"]) == (True, "streaming")
        assert status["result"]["health"]["frames"]["captured"] >= 0

        assert live.ask("profile", profile="paper") == {"ok": True, "result": {"profile": "paper"}}
        live.until("info", profile="paper")
        for name in ("slow", "auto"):  # the settings give no budget
            assert live.ask("profile", profile=name)["reason_code"] == "unknown_profile"
        assert live.ask("replay", paused=True)["reason_code"] == "unavailable"
        live.ask("profile", profile="fast")
        assert live.ask("stitch", action="begin")["reason_code"] == "unavailable"

        taken = live.ask("reference")
        assert taken["ok"] is True, taken
        assert taken["result"]["frames"] == 10
        crc = taken["result"]["calibration_crc32"]
        wait_until(
            lambda: live.last("info")["geometry"]["calibration_crc32"] == crc,
            5,
            "info reports the reference",
        )
        touch.set()
        heights = live.seen.wait_for(f"{BASE}/height", len(live.payloads("height")) + 1, 5)
        assert binary.decode(heights[-1]).calibration_crc32 == crc
        assert live.ask("reference")["reason_code"] == "frame_in_contact"


def test_requests_that_come_or_wait_while_it_stops_are_refused(
    live: Live, pictures: Any, scripted: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asks: dict[str, dict[str, Any]] = {
        "status": {},
        "profile": {"profile": "fast"},
        "reference": {},
    }
    asks["record"] = {"action": "start", "seconds": 9}
    close = FrameLedger.close

    def asked(ledger: FrameLedger, timeout_s: float) -> int:
        link = running.app.link
        before = link.counters()["requests"]
        for verb, body in asks.items():
            live.seen.publish(f"{BASE}/req/{verb}", json.dumps(body).encode())
        wait_until(lambda: link.counters()["requests"] == before + len(asks), 1, "heard")
        return close(ledger, timeout_s)

    monkeypatch.setattr(FrameLedger, "close", asked)
    with live.run(scripted(paced(pictures.free, period_s=0.2))) as running:
        wait_until(lambda: live.payloads("health"), 10, "health")
        live.seen.publish(f"{BASE}/req/reference", b'{"transaction": "waits"}')
        live.ask("status")  # after it
    live.until_state("stopped")
    for verb in asks:
        answer = live.last(f"res/{verb}")
        assert answer["reason_code"] == "daemon_stopped", answer
    answers = list(map(json.loads, live.payloads("res/reference")))
    assert [each["reason_code"] for each in answers] == ["daemon_stopped"] * 2
    assert [each["transaction"] for each in answers] == [None, "waits"]


def test_a_requested_reference_outlives_a_restart_and_a_reload(
    live: Live, pictures: Any, scripted: Any
) -> None:
    calibration_file.save(live.folder / "cal.npz", live.calibration)
    settings = live.document("calibration: cal.npz\n")
    darker = np.asarray(pictures.free * 0.8, np.uint8)

    def origin() -> tuple[str, int]:
        info = live.last("info")
        return info["reference"]["origin"], info["geometry"]["calibration_crc32"]

    with live.run(scripted(paced(darker)), settings) as app:
        live.until("status/camera", state="streaming")
        assert origin() == ("calibration", live.calibration.crc32)
        taken = live.ask("reference")["result"]
        assert taken["stored"] is True
        crc = taken["calibration_crc32"]
        wait_until(lambda: origin() == ("request", crc), 5, "info reports the reference")
        before = len(live.payloads("info"))
        app.app.reload()
        live.seen.wait_for(f"{BASE}/info", before + 1, 5)
        assert origin() == ("request", crc)
    before = len(live.payloads("info"))
    with live.run(scripted(paced(darker)), settings) as app:
        live.seen.wait_for(f"{BASE}/info", before + 1, 10)
        assert origin() == ("request", crc)
        other = replace(
            live.calibration,
            reference_grey=np.asarray(live.calibration.reference_grey // 2, np.uint8),
        )
        newer = calibration_file.save(live.folder / "cal.npz", other)
        app.app.reload()
        wait_until(lambda: origin() == ("calibration", newer.crc32), 5, "the new calibration's own")
        assert live.last("info")["reference"]["reason_code"] == "calibration_changed"


def test_the_reference_follows_a_light_that_ages_but_not_in_a_recording(
    live: Live, pictures: Any, scripted: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(untouched, "REST_S", 0.2)
    monkeypatch.setattr(untouched, "PERIOD_S", 0.2)
    age = threading.Event()

    def ageing() -> Iterator[Any]:
        while True:
            yield from paced(
                np.asarray(pictures.free * (0.9 if age.is_set() else 1.0), np.uint8), 2
            )

    def following() -> dict[str, Any]:
        reference: dict[str, Any] = live.last("health").get("reference", {})
        return reference

    with live.run(scripted(ageing())):
        wait_until(lambda: following().get("looks", 0) > 1, 10, "looks")
        assert (following()["state"], following()["renewals"]) == ("following", 0)
        ageing_now = following()["ageing"]
        assert (ageing_now["days"], ageing_now["ageing"], ageing_now["reason"]) == (1, [], "")
        assert live.ask("record", action="start", seconds=600, name="one")["ok"]
        age.set()
        wait_until(lambda: following()["state"] == "held", 10, "held")
        assert live.last("info")["geometry"]["calibration_crc32"] == live.calibration.crc32
        live.ask("record", action="stop")
        wait_until(lambda: following()["renewals"] == 1, 10, "a renewal")
        assert following()["light"] == pytest.approx(0.9, abs=0.03)
        info = live.last("info")
        assert info["geometry"]["calibration_crc32"] != live.calibration.crc32
        assert info["reference"]["calibration_crc32"] == live.calibration.crc32


def test_untouched_minutes_show_where_a_touch_begins_also_after_a_restart(
    live: Live, scripted: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(untouched, "REST_S", 0.2)
    monkeypatch.setattr(untouched, "PERIOD_S", 0.2)
    monkeypatch.setattr(untouched, "ENOUGH_FRAMES", 40)
    rest = [simulated(HALF).frame((), 900 + k).image for k in range(8)]
    faint, touch = pressed("ball", 0.1, HALF, 2.0).image, threading.Event()

    def resting() -> Iterator[Any]:
        for k in count():
            yield from paced(faint if touch.is_set() else rest[k % len(rest)], 1)

    live.calibration = calibration_file.save(live.folder / "cal.npz", calibrated(HALF, 0))
    settings = live.document("calibration: cal.npz\nprofile: fast\n")

    def crc() -> int:
        found: int = live.last("info")["geometry"]["calibration_crc32"]
        return found

    with live.run(scripted(resting()), settings):
        live.until("status/camera", state="streaming")
        assert crc() == live.calibration.crc32
        wait_until(lambda: crc() != live.calibration.crc32, 60, "limits")
        assert live.last("info")["reference"]["origin"] == "calibration"
        wait_until(lambda: live.last("health")["reference"]["rest_frames"] >= 40, 10, "frames")
        touch.set()
        assert live.until("contact", touched=1)["contact"] == 0
    learnt = crc()
    stored = reference_file.load(live.folder / "cal.reference.npz", live.calibration)
    assert stored is not None
    assert (stored.source, set(stored.limits)) == ("calibration", {"fast"})
    before = len(live.payloads("contact"))
    with live.run(scripted(resting()), settings):
        live.seen.wait_for(f"{BASE}/contact", before + 1, 15)
        assert live.until("contact", touched=1)["contact"] == 0
        assert crc() == learnt == stored.calibration.crc32


class Late:
    """A source whose frames are so many ms old when they come,
    as those of a machine that has other work.
    """

    def __init__(self, source: Any) -> None:
        self._source = source
        self.ms = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._source, name)

    def read(self) -> Any:
        frame = self._source.read()
        return frame and replace(frame, t_ns=frame.t_ns - self.ms * 1_000_000)


def test_auto_steps_down_under_a_load_and_up_after_it_and_says_so(
    live: Live,
    pictures: Any,
    scripted: Any,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    for name, value in (("PATIENCE_S", 0.2), ("WINDOW_FRAMES", 15), ("LATE_FRAMES", 2)):
        monkeypatch.setattr(active_profile, name, value)
    budget_ms = 1000  # of a test's machine, which has other work too
    source = Late(scripted(paced(pictures.touched, period_s=0.005)))
    ladder = list(LADDER)

    def used() -> list[str]:
        return [json.loads(payload)["profile"] for payload in live.payloads("info")]

    def budget() -> Any:
        return live.last("health").get("budget") or {}

    with live.run(source, f"profile: auto\nlatency_budget_ms: {budget_ms}\n"):
        wait_until(lambda: budget().get("kept"), 20, "the budget is kept")
        info = live.last("info")
        assert (info["choice"], info["profile"], info["profiles"]) == (
            "auto",
            ladder[0],
            [*PROFILES, "auto"],
        )
        assert budget()["p90_ms"] <= budget_ms == budget()["latency_budget_ms"]

        source.ms = 5 * budget_ms
        wait_until(lambda: used()[-1] == ladder[-1], 20, "stepped down")
        wait_until(lambda: budget().get("kept") is False, 20, "health says that it is not kept")
        assert (budget()["profile"], budget()["steps_down"], budget()["steps_up"]) == (
            ladder[-1],
            len(ladder) - 1,
            0,
        )
        assert budget()["p90_ms"] > budget_ms

        source.ms = 0
        wait_until(lambda: used()[-1] == ladder[0], 30, "stepped up")
        wait_until(lambda: budget().get("kept"), 20, "kept again")
        wait_until(lambda: budget()["steps_up"] == len(ladder) - 1, 20, "health counts the steps")
        assert [profile for profile, _ in groupby(used())] == ladder + ladder[-2::-1]
        assert all(json.loads(payload)["choice"] == "auto" for payload in live.payloads("info"))

        assert live.ask("profile", profile="fast")["result"] == {"profile": "fast"}
        live.until("info", choice="fast")
        live.until("health", budget=None)
        assert live.ask("profile", profile="auto")["result"] == {"profile": ladder[0]}
        live.until("info", choice="auto")
    live.until_state("stopped")
    assert_accounted(live.last("health")["frames"])
    steps = [
        record
        for record in caplog.records
        if record.getMessage().startswith("profile auto: stepped from ")
    ]
    assert len(steps) == 2 * (len(ladder) - 1)
