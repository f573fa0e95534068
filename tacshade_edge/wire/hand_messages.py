"""Encode ``tacshade/hand/<hand-id>/objects``: what all fingers of a hand touch,
in the hand's frame, as JSON.

Each finger's daemon computes its part, and the hand's own process merges the parts: `encode_finger`
and `decode_finger` carry a part from one to the other, `encode_hand` and `topics.decode_hand` serve
the topic.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np

from tacshade_edge.errors import DecodeError
from tacshade_edge.reasons import Reason, code_of
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F64, Reconstruction, TouchedObject
from tacshade_edge.wire.hand_topics import OBJECTS_MAX, Finger, HandObject, HandObjects, Triple

# 0.1 µm, finer than any sensor; all digits of a float64 would make the message twice as long.
_DIGITS: Final = 4


def finger_of(result: Reconstruction, hand_T_sensor: Rigid) -> Finger:
    """A finger's result as a report in the hand's frame, without its age."""
    objects: tuple[HandObject, ...] = ()
    if result.contact:
        points_mm, labels = hand_T_sensor.apply(result.cloud.points_mm), result.cloud.labels
        objects = tuple(
            _in_frame(touched, points_mm[labels == touched.label], hand_T_sensor)
            # The largest come first, so the smallest are left out.
            for touched in result.objects[:OBJECTS_MAX]
        )
    return Finger(
        # A frame that cannot be used says nothing about contacts: free would be a claim.
        state=("contact" if result.contact else "free") if result.valid else "away",
        t_ns=result.t_ns,
        seq=result.seq,
        reason_code=code_of(result.reason),
        degraded_code=code_of(result.degraded),
        axis=rounded_triple(hand_T_sensor.rotation[:, 2]),
        objects=objects,
        touched=result.touched,
    )


def away(reason: Reason) -> Finger:
    """The report of a finger whose contacts are unknown, without a frame."""
    return Finger(state="away", reason_code=reason.code)


def encode_finger(finger: Finger) -> bytes:
    """Encode a finger's report for the hand's own process."""
    return msgspec.json.encode(finger)


def decode_finger(payload: bytes) -> Finger:
    """Decode `encode_finger`'s output; our own process sent it, so only types are checked.

    Raises DecodeError.
    """
    try:
        return msgspec.json.decode(payload, type=Finger)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise DecodeError(f"a finger: {error}") from error


def encode_hand(hand: HandObjects) -> bytes:
    """The ``objects`` payload."""
    return msgspec.json.encode(hand)


def _in_frame(touched: TouchedObject, points_mm: F64, hand_T_sensor: Rigid) -> HandObject:
    """Transform an object to the hand's frame; `points_mm` are already in it."""
    turn = hand_T_sensor.rotation
    # Of the points, because a turned box is larger than what it contains; without points there is
    # only the box.
    extent_mm = (
        np.ptp(points_mm, axis=0) if len(points_mm) else np.abs(turn) @ np.array(touched.extent_mm)
    )
    # Shear has no z of its own: it lies in the finger's x, y plane.
    slide = (
        None
        if touched.shear_mm is None
        else rounded_triple(turn[:, :2] @ np.array(touched.shear_mm))
    )
    return HandObject(
        id=touched.id,
        centroid_mm=rounded_triple(hand_T_sensor.apply(np.array(touched.centroid_mm))),
        extent_mm=rounded_triple(extent_mm),
        normal=rounded_triple(turn @ np.array(touched.normal)),
        depth_max_mm=round(float(touched.depth_max_mm), _DIGITS),
        area_mm2=round(float(touched.area_mm2), _DIGITS),
        shear_mm=slide,
        twist_deg=_rounded(touched.twist_deg),
        slip=None if touched.slip is None else int(touched.slip),
        slip_mm_s=_rounded(touched.slip_mm_s),
    )


def rounded_triple(vector: F64) -> Triple:
    """Round a vector (3,) to the published precision."""
    # + 0.0 turns -0.0 into 0.0.
    x, y, z = (round(float(value), _DIGITS) + 0.0 for value in vector)
    return x, y, z


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(float(value), _DIGITS)
