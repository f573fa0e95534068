"""A part of the fault bench that fits a test run;
`python -m tools.faults` has the rest (reliability.md).
"""

from __future__ import annotations

import pytest

from tools.faults import kills, table
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
