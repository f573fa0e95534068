"""The hand: when its message is due, what it holds, and how that object moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.hand.fingers import (
    FIRST_NS,
    GATHER_NS,
    PATCHES_MAX,
    PERIOD_NS,
    QUIET_PERIOD_NS,
    STALE_NS,
    STALLED_NS,
    HandAggregator,
    HeldObject,
    messages,
    with_motion,
)
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.wire.hand_messages import away, encode_hand
from tacshade_edge.wire.hand_topics import OBJECTS_MAX, Finger, HandObject, HandObjects, Motion
from tacshade_edge.wire.topics import decode_hand

NOW_NS = 10**12

FREE = Finger(state="free", t_ns=NOW_NS - 2_000_000, seq=1)

TOUCHED = Finger(state="contact", t_ns=NOW_NS - 5_500_000, seq=2)


@pytest.fixture
def two() -> HandAggregator:
    """Listened to, and both have reported."""
    together = HandAggregator(["thumb", "index"])
    together.listen(NOW_NS, listened=True)
    for name in ("thumb", "index"):
        together.hear(name, FREE, NOW_NS)
    return together


def test_nothing_is_due_while_nobody_listens() -> None:
    together = HandAggregator(["thumb"])
    together.hear("thumb", FREE, NOW_NS)
    assert together.due_ns() is None


def test_the_first_message_waits_for_every_finger_and_not_for_ever() -> None:
    together = HandAggregator(["thumb", "index"])
    together.listen(NOW_NS, listened=True)
    together.hear("thumb", FREE, NOW_NS + 5)
    assert together.due_ns() == NOW_NS + FIRST_NS
    message = together.message(NOW_NS + FIRST_NS, 7)
    assert [(f.state, f.reason_code) for f in message.fingers.values()] == [
        ("free", ""),
        ("away", "starting"),
    ]
    assert (message.t_ns, message.wall_ns, message.seq) == (NOW_NS + FIRST_NS, 7, 0)


@pytest.mark.parametrize(
    ("reported", "period_ns"),
    [
        (TOUCHED, GATHER_NS),
        (replace(FREE, touched=True), GATHER_NS),
        (away(Reason(ReasonCode.LOST, "gone")), GATHER_NS),
        (FREE, QUIET_PERIOD_NS),
    ],
    ids=["contact", "touched", "change", "nothing new"],
)
def test_contact_and_change_are_reported_at_most_250_times_a_second_all_else_10_times(
    two: HandAggregator, reported: Finger, period_ns: int
) -> None:
    two.message(NOW_NS, 0)
    two.hear("thumb", reported, NOW_NS + 1)
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


def test_news_does_not_wait_for_a_finger_whose_next_frame_is_due_too_late(
    two: HandAggregator,
) -> None:
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


def test_a_finger_that_falls_silent_is_away(two: HandAggregator) -> None:
    two.hear("thumb", TOUCHED, NOW_NS)
    two.hear("index", away(Reason(ReasonCode.LOST, "gone")), NOW_NS)
    assert two.message(NOW_NS + STALLED_NS, 0).fingers["thumb"].state == "contact"
    fingers = two.message(NOW_NS + STALLED_NS + 1, 0).fingers
    assert [f.reason_code for f in fingers.values()] == ["stalled", "lost"]
    assert (fingers["thumb"].state, fingers["thumb"].objects) == ("away", ())
    two.hear("thumb", FREE, NOW_NS + STALLED_NS + 2)
    assert two.message(NOW_NS + STALLED_NS + 2, 0).fingers["thumb"].state == "free"


CONTACT = HandObject(
    id=1,
    centroid_mm=(0.0, 0.0, 20.0),
    extent_mm=(4.0, 4.0, 1.0),
    normal=(0.0, 0.0, 1.0),
    depth_max_mm=2.0,
    area_mm2=9.0,
    shear_mm=(0.0, 0.0, 0.0),
    twist_deg=0.0,
    slip=0,
    slip_mm_s=0.0,
)

PLACES = {"thumb": (20.0, 0.0, 0.0), "index": (-20.0, 0.0, 10.0), "ring": (-20.0, 0.0, -10.0)}


def finger(name: str, at_ns: int = NOW_NS, **values: object) -> Finger:
    """Pinches along x."""
    inward = -1.0 if PLACES[name][0] > 0 else 1.0
    facing = {"centroid_mm": PLACES[name], "normal": (inward, 0.0, 0.0)}
    held = replace(CONTACT, **facing, **values)
    return Finger(state="contact", t_ns=at_ns, seq=1, axis=(inward, 0.0, 0.0), objects=(held,))


def all_fingers(at_ns: int = NOW_NS, **values: object) -> dict[str, Finger]:
    return {name: finger(name, at_ns, **values) for name in PLACES}


def stepped(held: HeldObject, fingers: dict[str, Finger], now_ns: int) -> Motion:
    motion = held.step(fingers, now_ns)
    assert motion is not None
    return motion


def test_skin_that_all_goes_one_way_is_an_object_that_does() -> None:
    held = HeldObject()
    assert stepped(held, all_fingers(), NOW_NS).translation_mm == (0.0, 0.0, 0.0)
    later_ns = NOW_NS + PERIOD_NS
    motion = stepped(held, all_fingers(later_ns, shear_mm=(0.0, 0.5, -0.25)), later_ns)
    assert motion.translation_mm == pytest.approx((0.0, 0.5, -0.25), abs=0.02)
    assert motion.rotation_deg == pytest.approx((0.0, 0.0, 0.0), abs=0.1)
    assert (motion.since_ns, motion.left_out, motion.unobservable) == (NOW_NS, (), ())
    covariance = np.reshape(motion.covariance, (6, 6))
    assert covariance == pytest.approx(covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert 0.01 < covariance[3, 3] ** 0.5 < 10  # in degrees


@pytest.mark.parametrize("missing", ["shear_mm", "id"])
def test_what_is_not_followed_does_not_hold(missing: str) -> None:
    assert HeldObject().step(all_fingers(**{missing: None}), NOW_NS) is None


def test_a_finger_that_fell_silent_does_not_hold() -> None:
    held = HeldObject()
    assert held.step(all_fingers(NOW_NS), NOW_NS + STALE_NS) is not None
    assert held.step(all_fingers(NOW_NS), NOW_NS + STALE_NS + 1) is None


def test_between_two_fits_the_last_one_stands() -> None:
    held = HeldObject()
    first = stepped(held, all_fingers(), NOW_NS)
    moved = all_fingers(shear_mm=(0.0, 0.5, 0.0))
    assert held.step(moved, NOW_NS + PERIOD_NS - 1) is first
    assert held.step(moved, NOW_NS + PERIOD_NS) is not first
    assert held.step(dict.fromkeys(PLACES, Finger(state="free")), NOW_NS + PERIOD_NS + 1) is None


def test_the_message_of_five_fingers_is_one_that_decoders_take() -> None:
    objects = tuple(replace(finger("thumb").objects[0], id=k) for k in range(OBJECTS_MAX))
    full = replace(finger("thumb"), objects=objects)
    held = HeldObject()
    stepped(held, {"a": full}, NOW_NS)
    motion = stepped(held, dict.fromkeys("abcde", full), NOW_NS + PERIOD_NS)
    fingers = {name: with_motion(full, motion) for name in "abcde"}
    payload = encode_hand(HandObjects(t_ns=NOW_NS, wall_ns=NOW_NS, seq=1, fingers=fingers))
    assert [o.motion is None for o in decode_hand(payload).fingers["a"].objects] == [
        k >= PATCHES_MAX for k in range(OBJECTS_MAX)
    ]


FRAME_NS = 33_333_333


def reports(*states: str, late_ns: int = 0) -> list[tuple[int, int, Finger]]:
    times = (10**9 + late_ns + k * FRAME_NS for k in range(len(states)))
    return [
        (t_ns, t_ns + 7, Finger(state=state, t_ns=t_ns, seq=0))
        for t_ns, state in zip(times, states, strict=True)
    ]  # type: ignore[arg-type]


def test_frames_of_one_moment_are_one_message() -> None:
    touch = ("contact",) * 5
    made = list(
        messages({"thumb": reports(*touch), "index": reports(*touch, late_ns=GATHER_NS // 2)})
    )
    assert [m.seq for m in made] == list(range(5))
    for message in made:
        thumb, index = message.fingers.values()
        assert (thumb.t_ns, index.t_ns) == (message.t_ns - GATHER_NS // 2, message.t_ns)
        assert message.wall_ns == message.t_ns + 7
