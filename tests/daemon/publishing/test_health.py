from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.daemon.ledger import FrameLedger, FrameOutcome, Timings
from tacshade_edge.daemon.observer import FrameResult
from tacshade_edge.daemon.profiles import ActiveProfile
from tacshade_edge.daemon.publishing import Health
from tacshade_edge.daemon.record_requests import RecordRequests
from tacshade_edge.daemon.references import References
from tacshade_edge.daemon.robot import Robot
from tacshade_edge.daemon.session_worker import SessionRequests
from tacshade_edge.protocol.codec import encode_json
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Frame, HeightMap, ObjectCloud, Reconstruction

DOCUMENT = Path(__file__).parents[3] / "docs/reference/mqtt/health.md"


def test_rates_are_between_two_snapshots() -> None:
    ledger = FrameLedger()
    health = Health(ledger, Timings())
    ends: list[FrameOutcome] = ["published", "published", "without_contact", "unasked", "invalid"]
    for seq, end in enumerate(ends):
        ledger.captured(seq)
        ledger.settle(seq, end)
    first = health.snapshot(7, {"connects": 1})
    assert first["source_dropped"] == 7
    assert first["mqtt"] == {"connects": 1}
    assert first["frames"]["captured"] == 5
    assert first["latency_ms"] is None
    # one interval, so the rates have the ratio of the counts; they are rounded
    rates = [first[name] / first["capture_fps"] for name in ("delivered_fps", "published_fps")]
    assert [round(rate, 2) for rate in rates] == [0.8, 0.4]
    second = health.snapshot(7, {})
    assert (second["capture_fps"], second["delivered_fps"], second["published_fps"]) == (0, 0, 0)


def test_the_reason_of_the_newest_frame_stays_while_contacts_without_depth_follow() -> None:
    health = Health(FrameLedger(), Timings())
    frame = Frame(0, 0, 0, np.zeros((2, 2), np.uint8))
    empty = HeightMap(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.bool_), 0, 0, 1)
    cloud = ObjectCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16))
    torn = Reason(ReasonCode.TORN, "torn")
    health.see(FrameResult(frame, None, Reconstruction(0, 0, 0, "", False, torn, False, False, None, empty, cloud)))
    health.see(FrameResult(frame, None, None))
    assert health.snapshot(0, {})["invalid_reason_code"] == "torn"


def test_every_key_is_documented() -> None:
    section = DOCUMENT.read_text(encoding="utf-8").partition("## Health\n")[2].partition("\n## ")[0]
    documented = {
        name for row in re.findall(r"^\| (`.*?) \|", section, re.MULTILINE) for name in re.findall("`(.+?)`", row)
    }
    timings = Timings()
    timings.add({"wait": 1.0, "latency": 2.0})
    message = json.loads(encode_json(Health(FrameLedger(), timings).snapshot(0, {})))
    reported = {each.health_key for each in (Robot, SessionRequests, References, RecordRequests, ActiveProfile)}
    assert set(message) | reported == documented
    assert message["latency_ms"] == {"p50": 2.0, "p99": 2.0}
    assert message["stages_ms"] == {"wait": {"p50": 1.0, "p99": 1.0}}
    for name in message["frames"]:
        assert f"`{name}`" in section


@given(st.lists(st.integers(0, 3), max_size=30))
def test_captured_is_the_sum_of_the_others_in_every_snapshot(steps: list[int]) -> None:
    ledger = FrameLedger()
    health = Health(ledger, Timings())
    waiting: list[int] = []
    ends: list[FrameOutcome] = ["published", "superseded", "failed"]
    for seq, step in enumerate(steps):
        if step < 3 and waiting:
            ledger.settle(waiting.pop(), ends[step])
        else:
            ledger.captured(seq)
            waiting.append(seq)
        frames = health.snapshot(0, {})["frames"]
        assert frames.pop("captured") == sum(frames.values())
