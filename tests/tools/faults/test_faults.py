"""A part of the fault bench that fits a test run; `python -m tools.faults` has the rest (reliability.md)."""

from __future__ import annotations

from collections import Counter

import pytest

from tools.faults import damage, kills, soak, table, words
from tools.testbed.mqtt_rig import MOSQUITTO

needs_broker = [
    pytest.mark.slow,
    pytest.mark.broker,
    pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed"),
]
QUICK = (
    "an answer is wanted on the sensor's own topics",
    "a bit flipped in a session's presses",
    "recordings read while they are written",
    "the page is asked for by who may not",
)


@pytest.mark.slow
def test_damaged_inputs() -> None:
    """In a process of its own, which has the libraries of these tests beside: its memory is the bench's to judge."""
    out = damage.run_apart(0, 400, 17, None)
    assert [problem for problem in out.problems if not problem.endswith(" MB")] == []
    assert out.done == 400


def test_a_number_makes_the_same_input_again() -> None:
    kinds = damage.make_kinds()
    for kind in kinds.values():
        ones, others = (damage.damaged(kind, damage.random.Random("3:7")) for _ in range(2))
        assert ones == others


def test_what_another_value_is_of_a_checked_file() -> None:
    kind = damage.Kind({}, (), lambda _: None, checked=True)
    assert damage.judged(kind, 1, damage.Read(1)) == ("the same", "")
    assert damage.judged(kind, 1, damage.Read(error="FILE: found x, expected y")) == ("refused", "")
    assert damage.judged(kind, 1, damage.Read(2, told=["damaged"])) == ("told", "")
    assert damage.judged(kind, 1, damage.Read(2))[1] == "another value, and nothing was told"
    assert damage.judged(kind, 1, damage.Read(error="two\nlines"))[1]


class TestWithABroker:
    pytestmark = needs_broker

    @pytest.mark.parametrize("name", QUICK)
    def test_a_fault(self, name: str) -> None:
        assert table.run_one(table.FAULTS[name]).lost

    def test_requests_and_lines(self) -> None:
        came = words.run(3000, 3000, 300, 0, 17)
        assert came.problems == []
        assert came.sent == Counter({"in process": 3000, "serial lines": 3000}) | came.sent
        assert "files elsewhere" in words.table(came)

    def test_kills(self) -> None:
        out = kills.Kills()
        kills.run_daemons(8, 17, out, longest_s=1.0)
        kills.run_calibrations(2, 17, out)
        assert out.problems == []
        assert out.doing.total() == 10

    def test_a_moment_of_the_soak(self) -> None:
        out = soak.run(3.0)
        assert [problem for problem in out.problems if not problem.startswith("memory")] == []
        assert "frames: captured" in soak.table(out)
