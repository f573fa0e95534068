from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.contact.tracking import (
    LEAST_LIMIT,
    LIMIT,
    SLIDE_NS,
    ContactTracker,
    Grip,
)
from tacshade_edge.types import Slip, TouchedObject

FRAME_NS = 16_666_667
ALARM = 0.25  # margin of a contact that is about to slip
SHEAR_MM = st.floats(-30, 30)
FRAME = st.tuples(st.integers(0, 2**40), SHEAR_MM, SHEAR_MM, st.floats(0, 20), st.sampled_from(Slip))


def step(grip: Grip, frame: int, shear_mm: float, depth_mm: float = 2.0, slip: Slip = Slip.STICK) -> float:
    return grip.step(frame * FRAME_NS, (shear_mm, 0.0), depth_mm, slip)


@given(st.lists(FRAME, max_size=30))
def test_it_is_within_0_and_1(frames: list[tuple[int, float, float, float, Slip]]) -> None:
    grip = Grip()
    for t_ns, x_mm, y_mm, depth_mm, slip in frames:
        assert 0 <= grip.step(t_ns, (x_mm, y_mm), depth_mm, slip) <= 1
        assert grip.limit >= LEAST_LIMIT


@given(st.lists(SHEAR_MM, min_size=6, max_size=30), st.floats(0, 20))
def test_it_is_0_while_the_whole_contact_slides(shears_mm: list[float], depth_mm: float) -> None:
    grip = Grip()
    margins = [step(grip, k, shear_mm, depth_mm, Slip.FULL) for k, shear_mm in enumerate(shears_mm)]
    assert set(margins[-(-SLIDE_NS // FRAME_NS) :]) == {0.0}


@given(st.lists(st.floats(0, 5), min_size=2, max_size=10), st.floats(0.2, 5), st.floats(0.1, 4))
def test_more_load_along_is_less_margin_and_more_across_is_more(
    shears_mm: list[float], depth_mm: float, limit: float
) -> None:
    margins = [step(Grip(limit), 0, shear_mm, depth_mm) for shear_mm in sorted(shears_mm)]
    assert all(more <= less for less, more in pairwise(margins))
    assert margins[-1] <= step(Grip(limit), 0, max(shears_mm), 2 * depth_mm)


def test_what_only_presses_is_firm_and_what_is_loaded_to_the_limit_is_not() -> None:
    assert step(Grip(), 0, 0.0) == 1
    assert step(Grip(), 0, 0.5 * LIMIT * 2.0) == pytest.approx(0.5)
    assert step(Grip(), 0, LIMIT * 2.0) == 0


def test_the_limit_is_learned_from_a_slide() -> None:
    grip = Grip()
    for k in range(60):
        step(grip, k, 0.4, slip=Slip.FULL if 20 <= k < 30 else Slip.STICK)
    assert grip.limit == pytest.approx(0.2)
    for k in range(60, 120):
        margin = step(grip, k, 0.2)
    assert margin == pytest.approx(0.5, abs=1e-3)


def test_a_slide_of_two_frames_is_none() -> None:
    grip = Grip()
    margins = [step(grip, k, 0.4, slip=Slip.FULL if k in (20, 21) else Slip.STICK) for k in range(40)]
    assert (min(margins), grip.limit) == (pytest.approx(1 - 0.2 / LIMIT), LIMIT)


def test_noise_is_filtered() -> None:
    rng, grip = np.random.default_rng(1), Grip()
    margins = [step(grip, k, 0.7 + rng.normal(0, 0.1)) for k in range(600)]
    assert np.std(margins[60:]) < 0.5 * 0.1 / (2.0 * LIMIT)
    assert min(margins) > ALARM


def test_another_stream_begins_anew() -> None:
    grip = Grip()
    for k in range(20):
        step(grip, 100 + k, 1.4)
    assert step(grip, 0, 0.0) == 1


def test_a_load_that_went_back_was_borne() -> None:
    grip = Grip()
    margins = [step(grip, k, 1.0 + 0.3 * np.sin(k / 5)) for k in range(240)]
    assert grip.limit == pytest.approx(1.5 * 0.62, abs=0.01)
    assert margins[8] < ALARM < min(margins[40:])


def test_a_load_that_grows_is_not_borne_yet() -> None:
    grip = Grip()
    assert min(step(grip, k, 0.02 * k) for k in range(60)) < ALARM
    assert grip.limit == LIMIT


@pytest.mark.parametrize(("slid", "limit"), [(False, 0.9), (True, 0.6)])
def test_what_was_borne_shows_that_the_limit_is_higher(slid: bool, limit: float) -> None:
    grip = Grip()
    for k in range(10):
        step(grip, k, 0.4, slip=Slip.FULL if slid else Slip.STICK)
    for k in range(10, 120):
        step(grip, k, 1.2)
    assert grip.limit == pytest.approx(0.2 if slid else LIMIT)
    for k in range(120, 300):
        step(grip, k, 1.2)
    assert grip.limit == pytest.approx(limit, abs=1e-3)


def contact(
    x_mm: float, y_mm: float = 0.0, dragged_mm: float = 0.0, strain_mm: float = 0.0, depth_mm: float = 2.0
) -> TouchedObject:
    motion = {"shear_mm": (dragged_mm, 0.0), "strain_mm": strain_mm}
    return TouchedObject(1, (x_mm, y_mm, 0.0), (0.0, 0.0, 0.0), depth_mm, 1.0, **motion)  # type: ignore[arg-type]


def followed(tracker: ContactTracker, *objects: TouchedObject, frame: int = 0) -> tuple[TouchedObject, ...]:
    return tracker.step(frame * FRAME_NS, objects)


def test_an_object_keeps_its_number_while_it_touches_and_none_is_used_again() -> None:
    tracker = ContactTracker()
    assert [t.id for t in followed(tracker, contact(-5), contact(5))] == [1, 2]
    assert [t.id for t in followed(tracker, contact(5.5), contact(-5.5), frame=1)] == [2, 1]
    assert [t.id for t in followed(tracker, contact(6), frame=2)] == [2]
    assert [t.id for t in followed(tracker, contact(-6), contact(6.5), frame=3)] == [3, 2]
    assert followed(tracker, frame=4) == ()
    assert [t.id for t in followed(tracker, contact(6.5), frame=5)] == [4]


def test_what_the_skin_goes_along_with_does_not_slip() -> None:
    tracker = ContactTracker()
    for k in range(20):
        (found,) = followed(tracker, contact(0.3 * k, dragged_mm=0.3 * k), frame=k)
    assert found.slip is Slip.STICK
    assert found.slip_mm_s is not None
    assert found.slip_mm_s < 1e-6


def test_an_imprint_that_moves_over_the_material_slips_at_its_speed() -> None:
    tracker = ContactTracker()
    speed_mm_s = 5.0
    slips = []
    for k in range(20):
        at = speed_mm_s * max(0, k - 10) * FRAME_NS * 1e-9
        (found,) = followed(tracker, contact(2 + at, dragged_mm=2.0), frame=k)
        slips.append(found.slip)
    assert found.slip_mm_s is not None
    assert abs(found.slip_mm_s - speed_mm_s) < 0.01
    assert slips.index(Slip.FULL) * FRAME_NS <= 10 * FRAME_NS + 100_000_000
    assert Slip.FULL not in slips[:11]


def noisy(speed_mm_s: float, noise_mm: float, frames: int, onset: int, seed: int = 0) -> list[bool]:
    """Whether a slip is reported of each frame, of an imprint that slides from one on."""
    rng, tracker, slips = np.random.default_rng(seed), ContactTracker(), []
    for k in range(frames):
        x, y = rng.normal(0, noise_mm, 2)
        at = speed_mm_s * max(0, k - onset) * FRAME_NS * 1e-9
        (found,) = followed(tracker, contact(2 + at + x, y, dragged_mm=2.0), frame=k)
        slips.append(found.slip is Slip.FULL)
    return slips


@pytest.mark.slow
@pytest.mark.parametrize(("speed_mm_s", "noise_mm", "within_s"), [(5, 0.012, 0.1), (20, 0.06, 0.1), (5, 0.06, 0.25)])
def test_a_slip_is_reported_as_soon_as_it_stands_out_of_the_noise(
    speed_mm_s: float, noise_mm: float, within_s: float
) -> None:
    late = []
    for seed in range(20):
        slips = noisy(speed_mm_s, noise_mm, 80, 50, seed)
        late.append(slips.index(True, 50) - 50 if any(slips[50:]) else math.inf)
    assert np.quantile(late, 0.95) * FRAME_NS * 1e-9 <= within_s


@pytest.mark.parametrize("dragged_mm", [0.0, -2.0])
def test_a_contact_that_grows_on_one_side_does_not_slip(dragged_mm: float) -> None:
    """Its mean moves over skin that is not dragged, or against the way it is dragged."""
    tracker = ContactTracker()
    for k in range(20):
        (found,) = followed(tracker, contact(0.2 * k, dragged_mm=dragged_mm), frame=k)
    assert found.slip is not Slip.FULL
    assert found.slip_mm_s == pytest.approx(12.0, abs=0.01)


@pytest.mark.parametrize(("loosened", "slip"), [(0.0, Slip.STICK), (1.0, Slip.FULL)])
def test_skin_that_goes_back_slips_only_under_a_grip_that_is_loosened(loosened: float, slip: Slip) -> None:
    """By Coulomb's law a contact that slides bears its limit, which goes with its depth."""
    tracker = ContactTracker()
    for k in range(15):
        left = 1 - 0.05 * k
        (found,) = followed(tracker, contact(2.0, dragged_mm=2 * left, depth_mm=2 * left**loosened), frame=k)
    assert found.slip is slip
    assert found.slip_mm_s == pytest.approx(6.0, abs=0.01)


def test_a_contact_that_slides_in_a_part_only_does_not_slip_as_a_whole() -> None:
    tracker = ContactTracker()
    for k in range(20):
        (found,) = followed(tracker, contact(0.2 * k, dragged_mm=1.0 + 0.1 * k), frame=k)
    assert found.slip is not Slip.FULL
    assert found.slip_mm_s == pytest.approx(6.0, abs=0.01)
