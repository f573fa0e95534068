"""A touch that a map does not show, and a contact that is the tip's motion."""

from __future__ import annotations

import numpy as np
import pytest

from support.pin_pattern import N, X, Y, disc, pattern
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.contact.detection import DENT_PART, DENT_S, FAINT_GLARE, TouchDetector
from tacshade_edge.sensor.contact.motion import WhiteChange
from tacshade_edge.sensor.depth.solver import Depth
from tacshade_edge.types import F32, RestLimits

LIMITS = RestLimits(60, 1e-4, height_mm=0.02, local_change=0.01, changed_part=0.3)
S = 10**9


def detector(limits: RestLimits | None = LIMITS) -> TouchDetector:
    return TouchDetector(WhiteChange(pattern(), disc()), disc(), limits)


def depth(height_mm: float) -> Depth:
    """The most pressed hundredths of the disc at this height."""
    height = np.where(np.hypot(X, Y) < 0.25, height_mm, 0).astype(np.float32)
    return Depth(height, np.zeros((N, N), bool), False, 0)


def bump() -> F32:
    return (0.2 * np.exp(-((X - 0.3) ** 2 + Y**2) / (2 * 0.1**2))).astype(np.float32)


def code(reason: Reason | None) -> ReasonCode | None:
    return None if reason is None else reason.code


@pytest.mark.parametrize(
    ("height_mm", "white", "changed_part", "touched"),
    [
        (0.019, pattern(), 0.29, False),
        (0.021, pattern(), 0.0, True),
        (0.0, pattern() + bump(), 0.0, True),
        (0.0, pattern(), 0.31, True),
    ],
)
def test_each_kind_of_evidence_shows_a_touch(
    height_mm: float, white: F32, changed_part: float, touched: bool
) -> None:
    found = detector().felt(0, depth(height_mm), white, changed_part)
    assert code(found) is (ReasonCode.TOUCH_UNMEASURED if touched else None)
    assert detector(None).felt(0, depth(height_mm), white, changed_part) is None


def test_a_motion_of_the_whole_pattern_is_no_touch_unless_something_is_beyond_it() -> None:
    one, moved = detector(), pattern(turn=0.03)
    assert code(one.felt(0, depth(0.5), moved, 0.5)) is ReasonCode.TIP_MOVING
    assert code(one.felt(0, depth(0.5), moved + bump(), 0.5)) is ReasonCode.TOUCH_UNMEASURED
    assert one.felt(0, depth(0.0), moved, 0.0) is None


def test_faint_glare_is_no_touch() -> None:
    one, lit = detector(), pattern() + bump()
    assert code(one.felt(0, depth(0), lit, 0.0, lambda: FAINT_GLARE)) is ReasonCode.GLARE
    assert code(one.felt(0, depth(0), lit, 0.0, lambda: 5.0)) is ReasonCode.TOUCH_UNMEASURED
    assert code(one.felt(0, depth(0.5), lit, 0.0, lambda: FAINT_GLARE)) is ReasonCode.GLARE
    # No faint spot changes so much of the picture.
    found = one.felt(0, depth(0), lit, 0.5, lambda: FAINT_GLARE)
    assert code(found) is ReasonCode.TOUCH_UNMEASURED


def test_a_contact_is_one_unless_a_motion_explains_it() -> None:
    moved = pattern(turn=0.03)
    for one in (detector(None), detector()):
        assert one.moving(depth(0.01), lambda: pattern() + bump()) is None
        assert code(one.moving(depth(0.01), lambda: moved)) is ReasonCode.TIP_MOVING
        assert one.moving(depth(0.01), lambda: moved + bump()) is None
        assert one.moving(depth(0.01), lambda: pattern(turn=0.02)) is None
    # What goes beyond a rest that showed the tip's motions is a contact.
    assert detector().moving(depth(0.5), lambda: moved) is None
    assert code(detector(None).moving(depth(0.5), lambda: moved)) is ReasonCode.TIP_MOVING


def test_a_contact_leaves_a_dent_for_a_while() -> None:
    one, after_ns = detector(), round(DENT_S * S)
    one.contact(10 * S, 2.0)
    one.contact(11 * S, 1.0)
    dent = depth(0.9 * DENT_PART * 2.0)
    assert one.felt(11 * S + 1, dent, pattern() + bump(), 0.5) is None
    assert not one.relaxed(11 * S + after_ns)
    assert one.felt(11 * S + 1, depth(1.1 * DENT_PART * 2.0), pattern(), 0.0) is not None
    assert one.relaxed(11 * S + after_ns + 1)
    assert one.felt(11 * S + after_ns + 1, dent, pattern(), 0.0) is not None
    assert one.felt(11 * S, dent, pattern(), 0.0) is not None  # of the same time: no sequence
    one.contact(20 * S, 0.5)
    assert one.felt(21 * S, depth(0.9 * DENT_PART * 0.5), pattern(), 0.0) is None
    assert one.felt(21 * S, depth(1.1 * DENT_PART * 0.5), pattern(), 0.0) is not None


def test_a_disc_without_cells_has_no_height() -> None:
    outside = np.zeros((N, N), bool)
    made = TouchDetector(WhiteChange(pattern(), outside), outside, LIMITS)
    assert made.evidence(depth(1.0), pattern(), 0.1).height_mm == 0
