"""The hand's own topic: literal payloads, and an object turned into the hand's frame."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacshade_edge.errors import DecodeError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.types import ObjectCloud, Reconstruction, Slip, TouchedObject
from tacshade_edge.wire.hand_messages import (
    away,
    decode_finger,
    encode_finger,
    encode_hand,
    finger_of,
)
from tacshade_edge.wire.hand_topics import OBJECTS_MAX, HandObjects, Motion, Unobservable
from tacshade_edge.wire.topics import decode_hand

VECTORS = json.loads((Path(__file__).parent / "vectors" / "hand.json").read_text())
SOUND = [v for v in VECTORS if "expect" in v]
# A quarter turn about z, from x towards y, and 10, 0, 10 mm away.
TURNED = from_seven((10.0, 0.0, 10.0, 0.5**0.5, 0.0, 0.0, 0.5**0.5))


COVARIANCE = tuple(0.25 if k % 7 == 0 else 0.0 for k in range(36))
MOVED = Motion(
    since_ns=500,
    about_mm=(12.5, 1.25, 30.0),
    translation_mm=(0.5, 0.0, -0.25),
    rotation_deg=(0.0, 1.5, 0.0),
    covariance=COVARIANCE,
    unobservable=(Unobservable(axis=(0.0, 0.0, 1.0), through_mm=(12.5, 1.25, 30.0)),),
    left_out=("ring",),
)


def named(vector: dict[str, Any]) -> str:
    return str(vector["name"])


def touching(make_result: Callable[..., Reconstruction]) -> Reconstruction:
    """The first object's points span 4, 2 and 1 mm, the second's are one point."""
    points = np.array(((0, 0, 0), (4, 2, 1), (1, 1, 1)), np.float32)
    objects = (
        TouchedObject(
            1,
            (1.25, -2.5, 20.0),
            (9.0, 9.0, 9.0),
            1.75,
            8.5,
            (0.6, 0.0, 0.8),
            (0.5, 0.25),
            -3.5,
            id=3,
            slip=Slip.PARTIAL,
            slip_mm_s=0.75,
        ),
        TouchedObject(2, (9.0, 9.0, 16.0), (1.0, 1.0, 0.5), 0.5, 1.5),
    )
    glare = Reason(ReasonCode.GLARE, "glare")
    result = make_result(objects=objects, degraded=glare)
    cloud = ObjectCloud(points, np.array((1, 1, 2), np.uint16))
    return make_result(objects=result.objects, cloud=cloud, degraded=glare)


def test_the_first_vector_is_what_three_fingers_tell(
    make_result: Callable[..., Reconstruction],
) -> None:
    fingers = {
        "thumb": finger_of(touching(make_result), TURNED),
        "index": finger_of(make_result(contact=False, t_ns=1_000_000, seq=812), TURNED),
        "ring": away(Reason(ReasonCode.LOST, "gone")),
    }
    first, second = fingers["thumb"].objects
    held = (replace(first, motion=MOVED), second)
    fingers["thumb"] = replace(fingers["thumb"], objects=held)
    aged = dict(zip(fingers, (1.999, 1.0, None), strict=True))
    fingers = {name: replace(finger, age_ms=aged[name]) for name, finger in fingers.items()}
    message = HandObjects(t_ns=2_000_000, wall_ns=1_700_000_000_000_000_000, seq=7, fingers=fingers)
    assert encode_hand(message).decode() == SOUND[0]["payload"]


@pytest.mark.parametrize("vector", SOUND, ids=named)
def test_every_sound_vector_is_understood(vector: dict[str, Any]) -> None:
    hand, expect = decode_hand(vector["payload"].encode()), vector["expect"]
    assert (hand.t_ns, hand.seq) == (expect["t_ns"], expect["seq"])
    assert {name: finger.state for name, finger in hand.fingers.items()} == expect["states"]
    touched = [name for name, finger in hand.fingers.items() if finger.touched]
    assert touched == expect.get("touched", [])
    objects = [o for finger in hand.fingers.values() for o in finger.objects]
    moved = [o.motion and [*o.motion.translation_mm, *o.motion.rotation_deg] for o in objects]
    assert moved == expect["motions"]
    places = [list(o.centroid_mm) for o in objects]
    assert places == expect["centroids_mm"]
    assert [finger.age_ms for finger in hand.fingers.values()] == expect["ages_ms"]


@pytest.mark.parametrize("vector", [v for v in VECTORS if "error" in v], ids=named)
def test_every_damaged_vector_is_refused(vector: dict[str, Any]) -> None:
    with pytest.raises(
        DecodeError, match=r"^objects: .*; expected the format in docs/reference/mqtt\.md$"
    ):
        decode_hand(vector["payload"].encode())


def test_the_extent_is_that_of_the_points_along_the_hands_axes(
    make_result: Callable[..., Reconstruction],
) -> None:
    eighth = Rigid(
        from_seven((0, 0, 0, np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8))).rotation, np.zeros(3)
    )
    points = np.array(((0, 0, 0), (1, 1, 0)), np.float32)  # along y once it is turned by 45 degrees
    result = make_result(
        objects=(TouchedObject(1, (0.5, 0.5, 0), (1, 1, 0), 1, 1),), points_mm=points
    )
    (reported,) = finger_of(result, eighth).objects
    assert reported.extent_mm == pytest.approx((0.0, 2**0.5, 0.0), abs=1e-4)


def test_a_finger_reports_its_greatest_objects_only(
    make_result: Callable[..., Reconstruction],
) -> None:
    many = tuple(
        TouchedObject(k + 1, (0, 0, 0), (1, 1, 1), 1, 100 - k) for k in range(OBJECTS_MAX + 5)
    )
    finger = finger_of(make_result(objects=many), TURNED)
    assert [o.area_mm2 for o in finger.objects] == [100.0 - k for k in range(OBJECTS_MAX)]
    most = HandObjects(t_ns=2**62, wall_ns=2**62, seq=2**31, fingers=dict.fromkeys("abcde", finger))
    assert len(encode_hand(most)) < 29_000


def test_a_finger_goes_to_the_hand_and_comes_as_it_was(
    make_result: Callable[..., Reconstruction],
) -> None:
    finger = finger_of(touching(make_result), TURNED)
    assert decode_finger(encode_finger(finger)) == finger
    with pytest.raises(DecodeError, match=r"^a finger: "):
        decode_finger(b'{"state": "contact", "objects": [{}]}')
