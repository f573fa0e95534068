"""When a hand tells, and what of each finger."""

from __future__ import annotations

import pytest

from tacshade_edge.hand import FIRST_NS, GATHER_NS, QUIET_PERIOD_NS, STALLED_NS, HandAggregator
from tacshade_edge.protocol.hand import away
from tacshade_edge.protocol.topics import Finger
from tacshade_edge.reasons import Reason, ReasonCode

NOW_NS = 10**12
FREE = Finger(state="free", t_ns=NOW_NS - 2_000_000, seq=1)
TOUCHED = Finger(state="contact", t_ns=NOW_NS - 5_500_000, seq=2)


@pytest.fixture
def two() -> HandAggregator:
    """Listened to, and both have told."""
    together = HandAggregator(["thumb", "index"])
    together.listen(True, NOW_NS)
    for name in ("thumb", "index"):
        together.hear(name, FREE, NOW_NS)
    return together


def test_nothing_is_due_while_nobody_listens() -> None:
    together = HandAggregator(["thumb"])
    together.hear("thumb", FREE, NOW_NS)
    assert together.due_ns() is None


def test_the_first_message_waits_for_every_finger_and_not_for_ever() -> None:
    together = HandAggregator(["thumb", "index"])
    together.listen(True, NOW_NS)
    together.hear("thumb", FREE, NOW_NS + 5)
    assert together.due_ns() == NOW_NS + FIRST_NS
    message = together.message(NOW_NS + FIRST_NS, 7)
    assert [(f.state, f.reason_code) for f in message.fingers.values()] == [("free", ""), ("away", "starting")]
    assert (message.t_ns, message.wall_ns, message.seq) == (NOW_NS + FIRST_NS, 7, 0)


def test_it_is_due_at_once_when_all_have_told(two: HandAggregator) -> None:
    due_ns = two.due_ns()
    assert due_ns is not None
    assert due_ns <= NOW_NS


def test_every_finger_has_the_age_of_its_frame(two: HandAggregator) -> None:
    two.hear("index", TOUCHED, NOW_NS)
    two.hear("thumb", away(Reason(ReasonCode.LOST, "gone")), NOW_NS)
    fingers = two.message(NOW_NS, 0).fingers
    assert (fingers["index"].age_ms, fingers["thumb"].age_ms) == (5.5, None)
    assert list(fingers) == ["thumb", "index"]


@pytest.mark.parametrize(
    ("told", "period_ns"),
    [(TOUCHED, GATHER_NS), (away(Reason(ReasonCode.LOST, "gone")), GATHER_NS), (FREE, QUIET_PERIOD_NS)],
    ids=["contact", "change", "nothing new"],
)
def test_contact_and_change_are_reported_at_most_250_times_a_second_all_else_10_times(
    two: HandAggregator, told: Finger, period_ns: int
) -> None:
    two.message(NOW_NS, 0)
    two.hear("thumb", told, NOW_NS + 1)
    assert two.due_ns() == NOW_NS + period_ns


def test_news_waits_for_the_other_fingers_in_contact_and_not_for_long(two: HandAggregator) -> None:
    for name in ("thumb", "index"):
        two.hear(name, TOUCHED, NOW_NS)
    two.message(NOW_NS, 0)
    later_ns = NOW_NS + 10_000_000
    two.hear("thumb", TOUCHED, later_ns)
    assert two.due_ns() == later_ns + GATHER_NS
    two.hear("thumb", TOUCHED, later_ns + 2_000_000)
    assert two.due_ns() == later_ns + GATHER_NS
    two.hear("index", TOUCHED, later_ns + 3_000_000)
    assert two.due_ns() == later_ns
    two.message(later_ns + 3_000_000, 0)
    two.hear("index", FREE, later_ns + 19_000_000)  # only the thumb is in contact now, and old
    assert two.due_ns() == later_ns + 19_000_000 + GATHER_NS
    two.hear("thumb", TOUCHED, later_ns + 20_000_000)
    assert two.due_ns() == later_ns + 19_000_000


def test_news_does_not_wait_for_a_finger_whose_next_frame_is_due_too_late(two: HandAggregator) -> None:
    period_ns = 16_000_000
    for frame in range(3):
        for name, phase_ns in (("thumb", 0), ("index", 8_000_000)):
            two.hear(name, TOUCHED, NOW_NS + frame * period_ns + phase_ns)
    last_ns = NOW_NS + 2 * period_ns + 8_000_000
    two.message(last_ns, 0)
    two.hear("thumb", TOUCHED, NOW_NS + 3 * period_ns)
    assert two.due_ns() == NOW_NS + 3 * period_ns
    two.message(NOW_NS + 3 * period_ns, 0)
    early_ns = last_ns + period_ns - 2_000_000  # the index is expected 2 ms later
    two.hear("thumb", TOUCHED, early_ns)
    assert two.due_ns() == early_ns + GATHER_NS
    overdue_ns = last_ns + period_ns + 2_000_000
    two.message(early_ns, 0)
    two.hear("thumb", TOUCHED, overdue_ns)
    assert two.due_ns() == overdue_ns + GATHER_NS


def test_a_contact_that_is_told_is_no_news_until_its_next_frame(two: HandAggregator) -> None:
    two.hear("thumb", TOUCHED, NOW_NS)
    assert two.message(NOW_NS, 0).seq == 0
    assert two.due_ns() == NOW_NS + QUIET_PERIOD_NS
    assert two.message(NOW_NS + QUIET_PERIOD_NS, 0).seq == 1


def test_a_finger_that_falls_silent_is_away(two: HandAggregator) -> None:
    two.hear("thumb", TOUCHED, NOW_NS)
    two.hear("index", away(Reason(ReasonCode.LOST, "gone")), NOW_NS)
    assert two.message(NOW_NS + STALLED_NS, 0).fingers["thumb"].state == "contact"
    fingers = two.message(NOW_NS + STALLED_NS + 1, 0).fingers
    assert [f.reason_code for f in fingers.values()] == ["stalled", "lost"]
    assert (fingers["thumb"].state, fingers["thumb"].objects) == ("away", ())
    two.hear("thumb", FREE, NOW_NS + STALLED_NS + 2)
    assert two.message(NOW_NS + STALLED_NS + 2, 0).fingers["thumb"].state == "free"


def test_what_was_told_before_somebody_listened_is_no_news(two: HandAggregator) -> None:
    two.hear("thumb", TOUCHED, NOW_NS)
    two.hear("index", away(Reason(ReasonCode.LOST, "gone")), NOW_NS)
    two.listen(False, NOW_NS)
    later_ns = NOW_NS + 10**11
    two.listen(True, later_ns)
    two.listen(True, later_ns + FIRST_NS)
    fingers = two.message(later_ns + FIRST_NS, 0).fingers
    assert [f.reason_code for f in fingers.values()] == ["starting", "lost"]
