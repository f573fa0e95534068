from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from support.published_sensor import bump, unmeasured
from tacshade_edge.sensor.contact.tracking import ContactTracker, follow
from tacshade_edge.types import Slip, TouchedObject

FRAME_NS = 16_666_667


def contact(
    x_mm: float,
    y_mm: float = 0.0,
    dragged_mm: float = 0.0,
    strain_mm: float = 0.0,
    depth_mm: float = 2.0,
    extent_mm: float = 0.0,
) -> TouchedObject:
    extents_mm = (extent_mm, extent_mm, 0.0)
    return TouchedObject(
        1,
        (x_mm, y_mm, 0.0),
        extents_mm,
        depth_mm,
        1.0,
        shear_mm=(dragged_mm, 0.0),
        strain_mm=strain_mm,
    )


def followed(
    tracker: ContactTracker, *objects: TouchedObject, frame: int = 0
) -> tuple[TouchedObject, ...]:
    return tracker.step(frame * FRAME_NS, objects)


def test_an_object_keeps_its_number_while_it_touches_and_none_is_used_again() -> None:
    tracker = ContactTracker()
    assert [t.id for t in followed(tracker, contact(-5), contact(5))] == [1, 2]
    assert [t.id for t in followed(tracker, contact(5.5), contact(-5.5), frame=1)] == [2, 1]
    assert [t.id for t in followed(tracker, contact(6), frame=2)] == [2]
    assert [t.id for t in followed(tracker, contact(-6), contact(6.5), frame=3)] == [3, 2]
    assert followed(tracker, frame=4) == ()
    assert [t.id for t in followed(tracker, contact(6.5), frame=5)] == [4]


def test_a_frame_of_unknown_depth_neither_ends_nor_begins_an_object() -> None:
    tracker = ContactTracker()
    pressed = replace(bump(0, 2.0, 236, 328, 8), objects=(contact(5),))
    lost = unmeasured(1)
    assert [each.id for each in follow(tracker, pressed).objects] == [1]
    assert follow(tracker, lost) is lost
    assert [each.id for each in follow(tracker, pressed).objects] == [1]


def parted(apart_mm: float, x_mm: float = 0.0) -> tuple[TouchedObject, TouchedObject]:
    """Two objects that touch, the larger first."""
    return (
        contact(x_mm - apart_mm / 2, dragged_mm=2.0, extent_mm=6.0),
        contact(x_mm + apart_mm / 2, dragged_mm=2.0, extent_mm=5.0),
    )


def joined(apart_mm: float, x_mm: float = 0.0) -> TouchedObject:
    """The same objects as one contact."""
    return contact(x_mm, dragged_mm=2.0, extent_mm=apart_mm + 5.5)


@pytest.mark.parametrize("apart_mm", [6.0, 12.0])
@pytest.mark.parametrize("one_first", [False, True])
def test_objects_that_are_one_contact_in_some_frames_keep_their_numbers_and_do_not_slip(
    apart_mm: float, one_first: bool
) -> None:
    tracker, numbers = ContactTracker(), set()
    for frame in range(40):
        x_mm = 0.02 * frame
        whole = frame % 3 == 0 if one_first else frame % 3 == 2
        now = (joined(apart_mm, x_mm),) if whole else parted(apart_mm, x_mm)
        found = followed(tracker, *now, frame=frame)
        assert all(each.slip is not Slip.FULL for each in found)
        if not whole:
            numbers.add(tuple(each.id for each in found))
    assert len(numbers) == 1
    assert sorted(numbers.pop()) == [1, 2]


def test_a_part_that_is_lifted_off_is_forgotten() -> None:
    tracker = ContactTracker()
    assert [t.id for t in followed(tracker, *parted(6.0))] == [1, 2]
    assert len(followed(tracker, joined(6.0), frame=1)) == 1
    assert followed(tracker, frame=2) == ()
    assert [t.id for t in followed(tracker, *parted(6.0), frame=3)] == [3, 4]


def test_a_part_moves_with_the_object_that_it_is_a_part_of() -> None:
    tracker = ContactTracker()
    assert [t.id for t in followed(tracker, *parted(12.0))] == [1, 2]
    for frame in range(1, 30):
        followed(tracker, joined(12.0, 0.4 * frame), frame=frame)
    assert sorted(t.id or 0 for t in followed(tracker, *parted(12.0, 12.0), frame=30)) == [1, 2]


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
@pytest.mark.parametrize(
    ("speed_mm_s", "noise_mm", "within_s"), [(5, 0.012, 0.1), (20, 0.06, 0.1), (5, 0.06, 0.25)]
)
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
def test_skin_that_goes_back_slips_only_under_a_grip_that_is_loosened(
    loosened: float, slip: Slip
) -> None:
    """By Coulomb's law a contact that slides bears its limit, which goes with its depth."""
    tracker = ContactTracker()
    for k in range(15):
        left = 1 - 0.05 * k
        (found,) = followed(
            tracker, contact(2.0, dragged_mm=2 * left, depth_mm=2 * left**loosened), frame=k
        )
    assert found.slip is slip
    assert found.slip_mm_s == pytest.approx(6.0, abs=0.01)


def test_a_contact_that_slides_in_a_part_only_does_not_slip_as_a_whole() -> None:
    tracker = ContactTracker()
    for k in range(20):
        (found,) = followed(tracker, contact(0.2 * k, dragged_mm=1.0 + 0.1 * k), frame=k)
    assert found.slip is not Slip.FULL
    assert found.slip_mm_s == pytest.approx(6.0, abs=0.01)
