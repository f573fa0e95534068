"""Which contacts hold, and how their object's motion is published."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.hand import PATCHES_MAX, PERIOD_NS, STALE_NS, HeldObject, with_motion
from tacshade_edge.protocol.hand import encode_hand
from tacshade_edge.protocol.topics import OBJECTS_MAX, Finger, HandObject, HandObjects, Motion, decode_hand

NOW_NS = 10**12
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


def test_a_finger_over_which_it_slips_is_left_out_and_named() -> None:
    held = HeldObject()
    stepped(held, all_fingers(), NOW_NS)
    later_ns = NOW_NS + PERIOD_NS
    fingers = all_fingers(later_ns) | {"ring": finger("ring", later_ns, slip=2, shear_mm=(0.0, 3.0, 0.0))}
    motion = stepped(held, fingers, later_ns)
    assert motion.left_out == ("ring",)
    assert motion.translation_mm == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    assert len(motion.unobservable) == 1


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
