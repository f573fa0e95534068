from __future__ import annotations

import json
import re
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.daemon.pipeline.ledger import FrameLedger, FrameOutcome, Timings
from tacshade_edge.daemon.publishing.health import Health
from tacshade_edge.protocol.messages import encode_health

DOCUMENT = Path(__file__).parents[3] / "docs" / "mqtt.md"


def test_rates_are_between_two_snapshots() -> None:
    ledger = FrameLedger()
    health = Health(ledger, Timings())
    ends: list[FrameOutcome] = ["published", "published", "without_contact", "unasked", "invalid"]
    for seq, end in enumerate(ends):
        ledger.captured(seq)
        ledger.settle(seq, end)
    first = health.snapshot(None, 7, {"connects": 1}, {"written": 3}, None)
    assert first["source_dropped"] == 7
    assert first["mqtt"] == {"connects": 1}
    assert first["recorder"] == {"written": 3}
    assert first["frames"]["captured"] == 5
    assert first["latency_ms"] is None
    # one interval, so the rates have the ratio of the counts; they are rounded
    rates = [first[name] / first["capture_fps"] for name in ("delivered_fps", "published_fps")]
    assert [round(rate, 2) for rate in rates] == [0.8, 0.4]
    second = health.snapshot(None, 7, {}, {}, None)
    assert (second["capture_fps"], second["delivered_fps"], second["published_fps"]) == (0, 0, 0)


def test_every_key_is_documented() -> None:
    section = DOCUMENT.read_text(encoding="utf-8").partition("## Health and status")[2].partition("\n## ")[0]
    documented = {
        name for row in re.findall(r"^\| (`.*?) \|", section, re.MULTILINE) for name in re.findall("`(.+?)`", row)
    }
    timings = Timings()
    timings.add({"wait": 1.0, "capture_to_offer": 2.0})
    message = json.loads(encode_health(Health(FrameLedger(), timings).snapshot(None, 0, {}, {}, None)))
    # The app adds these: with a robot, where frames have poses, and how the reference follows.
    assert set(message) | {"serial", "stitching", "reference"} == documented
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
        frames = health.snapshot(None, 0, {}, {}, None)["frames"]
        assert frames.pop("captured") == sum(frames.values())
