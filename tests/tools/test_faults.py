"""A part of the fault bench that fits a test run;
`python -m tools.faults` has the rest (reliability.md).
"""

from __future__ import annotations

import pytest

from tools.faults import ends, kills, table
from tools.faults.rig import FAULTS

pytestmark = [pytest.mark.slow, pytest.mark.broker]
QUICK = ("a bit flipped in a session's presses", "a recording read while it is written")


@pytest.mark.parametrize("name", QUICK)
def test_a_fault(name: str) -> None:
    assert table.run_one(FAULTS[name])[2]


def test_kills() -> None:
    text, problems = kills.run(5, 17, longest_s=1.0)
    assert problems == []
    assert "| all | 5 |" in text


ENDS = (
    ends.End("start", "tacshade_edge.pipeline.pipeline:Pipeline.start", "9"),
    ends.End("stop", "tacshade_edge.recording.recorder:RecordingWriter.finish", "9"),
    ends.End("stop", "tacshade_edge.mqtt.outgoing:Outgoing._end", "15"),
    ends.End("stop", ends.STOPPING, "wait"),
)


def test_ends() -> None:
    assert set(ENDS) <= set(ends.ends())
    text, problems = ends.run(list(ENDS))
    assert problems == []
    assert "| stop | 3 |" in text
