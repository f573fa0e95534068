"""A held object's motion from patches whose skin sticks,
against the motion that they were made of.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.hand.object_tracking import OBSERVED_SD_MM, ObjectMotion, ObjectTracker, Patch
from tacshade_edge.rigid import Rigid, turn, turned_rad
from tacshade_edge.types import F64

AWAY_MM = np.array((40.0, -30.0, 60.0))
"""The object is far from the hand's origin."""
STILL = Rigid(np.eye(3), np.zeros(3))
SECOND_NS = 1_000_000_000


def about(
    point_mm: F64, rotation_rad: tuple[float, ...], translation_mm: tuple[float, ...]
) -> Rigid:
    rotation = turn(rotation_rad).rotation
    return Rigid(rotation, point_mm + np.array(translation_mm) - rotation @ point_mm)


def three(vector: F64) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


def patch(k: int, moved: Rigid, slips: bool = False) -> Patch:
    """Finger `k` of five around a cylinder of radius 20 mm, on a dome of the same radius;
    some lean.
    """
    a = 2 * math.pi * k / 5
    normal = -np.array((math.cos(a), math.sin(a), 0.0))
    axis = turn((0.0, 0.0, 0.2 * (k % 3 - 1))).rotation @ normal
    place = AWAY_MM - 20 * normal + (0.0, 0.0, 8.0 * (k % 3 - 1))
    centre, now = place - 18.0 * normal, moved.apply(place)
    radial, way = now - centre, now - place
    w = turned_rad(moved.rotation)
    twist = 0.5 * (axis @ w + normal @ w / (normal @ axis))
    return Patch(
        three(now),
        three(radial / np.linalg.norm(radial)),
        three(axis),
        three(way - axis * (axis @ way)),
        20.0 - float(np.linalg.norm(radial)),
        math.degrees(twist),
        slips,
    )


def patches(keys: str, moved: Rigid, slipping: str = "") -> Mapping[str, Patch]:
    return {key: patch(int(key), moved, key in slipping) for key in keys}


def stepped(tracker: ObjectTracker, t_ns: int, held: Mapping[str, Patch]) -> ObjectMotion:
    found = tracker.step(t_ns, held)
    assert found is not None
    return found


def rigid(found: ObjectMotion) -> Rigid:
    rotation = turn(found.rotation_rad).rotation
    return Rigid(rotation, found.about_mm + found.translation_mm - rotation @ found.about_mm)


def off(found: ObjectMotion, truth: Rigid) -> tuple[float, float]:
    """In mm, amid the object, and in degrees."""
    way = rigid(found).apply(AWAY_MM) - truth.apply(AWAY_MM)
    turned = turned_rad(rigid(found).rotation @ truth.rotation.T)
    return float(np.linalg.norm(way)), math.degrees(np.linalg.norm(turned))


small_mm, small_rad = st.floats(-1.0, 1.0), st.floats(-0.06, 0.06)


@given(st.tuples(small_mm, small_mm, small_mm), st.tuples(small_rad, small_rad, small_rad))
def test_five_fingers_find_the_motion(
    translation_mm: tuple[float, ...], rotation_rad: tuple[float, ...]
) -> None:
    truth, tracker = about(AWAY_MM, rotation_rad, translation_mm), ObjectTracker()
    assert stepped(tracker, 0, patches("01234", STILL)).translation_mm == pytest.approx([0, 0, 0])
    found = stepped(tracker, SECOND_NS, patches("01234", truth))
    off_mm, off_deg = off(found, truth)
    assert off_mm < 0.02
    assert off_deg < 0.1
    assert found.unobserved == ()
    assert np.linalg.eigvalsh(found.covariance).min() > 0
    assert np.sqrt(np.trace(found.covariance[:3, :3])) < OBSERVED_SD_MM


def test_two_fingers_name_the_line_through_both_and_say_nothing_of_a_turn_about_it() -> None:
    tracker = ObjectTracker()
    first = patches("02", STILL)
    line = np.subtract(first["2"].place_mm, first["0"].place_mm)
    line /= np.linalg.norm(line)
    stepped(tracker, 0, first)
    truth = about(np.array(first["0"].place_mm), tuple(0.15 * line), (0.0, 0.0, 0.0))
    found = stepped(tracker, SECOND_NS, patches("02", truth))
    (hidden,) = found.unobserved
    assert hidden.through_mm is not None
    assert abs(line @ hidden.axis) > 0.999
    off_line = np.cross(np.subtract(hidden.through_mm, first["0"].place_mm), line)
    assert np.linalg.norm(off_line) < 0.5
    assert abs(found.rotation_rad @ line) < 0.01
    assert math.degrees(math.sqrt(line @ found.covariance[3:, 3:] @ line)) > 90
    places = np.array([one.place_mm for one in first.values()])
    assert rigid(found).apply(places) == pytest.approx(truth.apply(places), abs=0.1)


def test_one_finger_names_all_turns_and_follows_its_patch() -> None:
    tracker, truth = ObjectTracker(), about(AWAY_MM, (0.0, 0.0, 0.0), (0.5, 1.0, -0.5))
    stepped(tracker, 0, patches("1", STILL))
    found = stepped(tracker, SECOND_NS, patches("1", truth))
    assert found.translation_mm == pytest.approx([0.5, 1.0, -0.5], abs=0.02)
    assert found.rotation_rad == pytest.approx([0, 0, 0])
    place = found.about_mm
    assert [line.through_mm is not None for line in found.unobserved] == [True] * 3
    axes = np.array([line.axis for line in found.unobserved])
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-6)
    for line in found.unobserved:
        assert np.linalg.norm(np.cross(place - line.through_mm, line.axis)) < 0.01


@pytest.mark.parametrize("change", ["leaves", "joins", "slips"])
def test_a_finger_that_changes_makes_no_jump_and_the_motion_goes_on(change: str) -> None:
    tracker = ObjectTracker()
    last = before = None
    for k in range(61):
        truth = about(AWAY_MM, (0.0, 0.002 * k, 0.001 * k), (0.02 * k, 0.0, -0.01 * k))
        keys = {
            "leaves": "01234" if k < 30 else "0123",
            "joins": "0123" if k < 30 else "01234",
        }.get(change, "01234")
        held = dict(patches(keys, truth, "4" if change == "slips" and k >= 30 else ""))
        if change == "joins" and k >= 30:  # its skin was not dragged when it touched
            touched = about(AWAY_MM, (0.0, 0.06, 0.03), (0.6, 0.0, -0.3))
            held["4"] = patch(4, truth @ touched.inverse())
        if change == "slips" and k >= 30:
            held["4"] = Patch(
                *(getattr(held["4"], n) for n in ("place_mm", "normal", "axis")),
                (5.0, 0.0, 0.0),
                9.0,
                None,
                True,
            )
        found = stepped(tracker, k * SECOND_NS // 60, held)
        error = rigid(found).apply(AWAY_MM) - truth.apply(AWAY_MM)
        assert before is None or np.linalg.norm(error - before) < 0.02, k
        last, before = found, error
    assert last is not None
    off_mm, off_deg = off(last, truth)
    assert off_mm < 0.1
    assert off_deg < 0.3
    assert last.since_ns == 0


def test_a_turn_that_nobody_saw_stays_unknown_when_a_finger_joins() -> None:
    tracker = ObjectTracker()
    stepped(tracker, 0, patches("02", STILL))
    seen_late = stepped(tracker, 10 * SECOND_NS, patches("02", STILL))
    joined = stepped(tracker, 10 * SECOND_NS + 1, patches("0123", STILL))
    assert len(seen_late.unobserved) == len(joined.unobserved) == 1
    at_once = ObjectTracker()
    stepped(at_once, 0, patches("02", STILL))
    assert stepped(at_once, SECOND_NS // 60, patches("0123", STILL)).unobserved == ()


def test_where_every_patch_slips_the_motion_stands_still_and_nothing_is_observed() -> None:
    tracker, truth = ObjectTracker(), about(AWAY_MM, (0.0, 0.05, 0.0), (1.0, 0.0, 0.0))
    stepped(tracker, 0, patches("01234", STILL))
    stuck = stepped(tracker, SECOND_NS, patches("01234", truth))
    slid = stepped(tracker, SECOND_NS + 1, patches("01234", STILL, "01234"))
    assert slid.translation_mm == pytest.approx(stuck.translation_mm)
    assert slid.rotation_rad == pytest.approx(stuck.rotation_rad)
    assert len(slid.unobserved) == 6


@pytest.mark.slow
def test_at_rest_a_finger_that_comes_and_goes_adds_nothing_up() -> None:
    rng, tracker = np.random.default_rng(0), ObjectTracker()
    for k in range(600):
        held = {}
        for key, one in patches("0123" if k % 20 < 10 else "01234", STILL).items():
            shear = np.array(one.shear_mm) + rng.normal(0, 0.01, 3)
            held[key] = Patch(
                one.place_mm,
                one.normal,
                one.axis,
                three(shear),
                one.depth_mm + rng.normal(0, 0.03),
                None,
            )
        found = stepped(tracker, k * SECOND_NS // 60, held)
    assert off(found, STILL)[0] < 0.15


@given(st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_any_finite_patch_gives_a_finite_motion(count: int, seed: int) -> None:
    rng, tracker = np.random.default_rng(seed), ObjectTracker()
    for k in range(3):
        held = {}
        for i in range(count):
            normal, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
            place, shear = rng.uniform(-1e3, 1e3, 3), rng.uniform(-50, 50, 3)
            twist = None if rng.uniform() < 0.5 else float(rng.uniform(-180, 180))
            held[f"{i}"] = Patch(
                three(place), three(normal), three(axis), three(shear), rng.uniform(0, 20), twist
            )
        found = stepped(tracker, k, held)
        for values in (found.translation_mm, found.rotation_rad, found.covariance):
            assert np.isfinite(values).all()
