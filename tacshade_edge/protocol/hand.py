"""``tacshade/hand/<hand-id>/objects``: what all fingers of a hand touch, in the hand's frame. Pure JSON.

A finger's part is made where its frames are, and put beside the others' by the hand's own process: `encode_finger` and
`decode_finger` are between these two, `encode_hand` and `decode_hand` are of the topic.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from msgspec import Meta

from tacshade_edge.protocol.received import Count
from tacshade_edge.protocol.strict import decode
from tacshade_edge.reasons import Reason, code_of
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F64, Reconstruction, TouchedObject

FingerState = Literal["contact", "free", "away"]
_Value = Annotated[float, Meta(ge=-1e9, le=1e9)]
Triple = tuple[_Value, _Value, _Value]

OBJECTS_MAX: Final = 16
"""The greatest of a finger: what five fingers publish stays within 29 kB, and as much again with its motion."""
FINGERS_MAX: Final = 32
_DIGITS: Final = 4  # 0.1 µm


class Unobservable(msgspec.Struct, frozen=True, kw_only=True):
    """A motion that the fingers cannot see: a rotation about a line, or a translation along it.

    Attributes
    ----------
    axis : 3 floats
        Unit vector.
    through_mm : 3 floats or None
        A point of the line; None: a translation.
    """

    axis: Triple
    through_mm: Triple | None


class Motion(msgspec.Struct, frozen=True, kw_only=True):
    """How the object that the hand holds has moved: what was at p is at R (p - about) + about + translation.

    Attributes
    ----------
    since_ns : int
        Capture of the frame with which it was grasped.
    about_mm, translation_mm : 3 floats
        A point amid the fingers' patches, and how far that has moved.
    rotation_deg : 3 floats
        Rotation vector of R.
    covariance : 36 floats
        6x6, row by row: of `translation_mm`, and of a small rotation after R in degrees.
    unobservable : tuple of Unobservable
        0 in the motion, and large in the covariance.
    left_out : tuple of str
        Fingers over which the object slips.
    """

    since_ns: Count
    about_mm: Triple
    translation_mm: Triple
    rotation_deg: Triple
    covariance: Annotated[tuple[_Value, ...], Meta(min_length=36, max_length=36)]
    unobservable: Annotated[tuple[Unobservable, ...], Meta(max_length=6)] = ()
    left_out: Annotated[tuple[str, ...], Meta(max_length=FINGERS_MAX)] = ()


class HandObject(msgspec.Struct, frozen=True, kw_only=True):
    """An object that a finger touches; all in mm, and all vectors along the hand's axes.

    Attributes
    ----------
    id : int or None
        The same while this finger touches it.
    centroid_mm, extent_mm : 3 floats
        Mean, and max - min, of the skin's points that touch it.
    normal : 3 floats
        Unit normal of the plane through these points, away from the finger's camera.
    depth_max_mm, area_mm2 : float
    shear_mm : 3 floats or None
        Mean shear of the skin that it touches, which lies in the finger's x, y plane; None where none is reported.
    twist_deg : float or None
        About the finger's own z axis.
    slip : int or None
        0 stick, 1 partial, 2 full.
    slip_mm_s : float or None
    motion : Motion or None
        Of what the whole hand holds; None where no shear is reported, and from a finger to its hand.
    """

    id: int | None
    centroid_mm: Triple
    extent_mm: Triple
    normal: Triple
    depth_max_mm: _Value
    area_mm2: _Value
    shear_mm: Triple | None
    twist_deg: _Value | None
    slip: Annotated[int, Meta(ge=0, le=2)] | None
    slip_mm_s: _Value | None
    motion: Motion | None = None


class Finger(msgspec.Struct, frozen=True, kw_only=True):
    """What a finger reported last.

    Attributes
    ----------
    state : str
        ``contact``, ``free``, or ``away``: nothing is known of what it touches, for `reason_code`.
    t_ns : int or None
        Capture of its frame, on the clock that all fingers have in common; None of what no frame reported.
    age_ms : float or None
        So old the frame was when the hand published it.
    seq : int or None
        The frame's.
    reason_code, degraded_code : str
        Codes of `reasons.ReasonCode`; empty when all is well.
    axis : 3 floats or None
        Its own z axis: shear is at right angles to it, twist is about it. None of what no frame reported.
    margin : float or None
        Least of its objects' before a slip, 1 firm to 0 sliding; None without contact, or where no shear is reported.
    objects : tuple of HandObject
        The greatest first, at most `OBJECTS_MAX`; empty unless `state` is ``contact``.
    """

    state: FingerState
    t_ns: Count | None = None
    age_ms: _Value | None = None
    seq: Count | None = None
    reason_code: str = ""
    degraded_code: str = ""
    axis: Triple | None = None
    margin: Annotated[float, Meta(ge=0, le=1)] | None = None
    objects: Annotated[tuple[HandObject, ...], Meta(max_length=OBJECTS_MAX)] = ()


class HandObjects(msgspec.Struct, frozen=True, kw_only=True):
    """One message: every finger of the hand by its sensor's id.

    Attributes
    ----------
    t_ns, wall_ns : int
        When it was put together, on the fingers' clock and in Unix time.
    seq : int
        Counts these messages from 0 since the hand's process began.
    fingers : dict of str to Finger
        In the order of the settings.
    """

    t_ns: Count
    wall_ns: Count
    seq: Count
    fingers: Annotated[dict[str, Finger], Meta(max_length=FINGERS_MAX)]

    @property
    def motion(self) -> Motion | None:
        """Of the object that the hand holds; None where no finger that touches it reports shear."""
        found = (o.motion for finger in self.fingers.values() for o in finger.objects if o.motion is not None)
        return next(found, None)


def finger_of(result: Reconstruction, hand_T_sensor: Rigid) -> Finger:
    """What one result of a finger reports in the hand's frame, without its age."""
    objects: tuple[HandObject, ...] = ()
    if result.contact:
        points_mm, labels = hand_T_sensor.apply(result.cloud.points_mm), result.cloud.labels
        objects = tuple(
            _in_frame(touched, points_mm[labels == touched.label], hand_T_sensor)
            for touched in result.objects[:OBJECTS_MAX]
        )
    return Finger(
        state=("contact" if result.contact else "free") if result.valid else "away",
        t_ns=result.t_ns,
        seq=result.seq,
        reason_code=code_of(result.reason),
        degraded_code=code_of(result.degraded),
        axis=rounded_triple(hand_T_sensor.rotation[:, 2]),
        margin=_rounded(min((o.margin for o in result.objects if o.margin is not None), default=None)),
        objects=objects,
    )


def away(reason: Reason) -> Finger:
    """A finger of which nothing is known, though no frame says so."""
    return Finger(state="away", reason_code=reason.code)


def encode_finger(finger: Finger) -> bytes:
    """For the hand's own process."""
    return msgspec.json.encode(finger)


def decode_finger(payload: bytes) -> Finger:
    """Understand `encode_finger`. Raises DecodeError."""
    return decode("a finger", payload, Finger)


def encode_hand(hand: HandObjects) -> bytes:
    """The ``objects`` payload."""
    return msgspec.json.encode(hand)


def decode_hand(payload: bytes) -> HandObjects:
    """Understand an ``objects`` payload; keys that are not known are ignored. Raises DecodeError."""
    return decode("objects", payload, HandObjects)


def _in_frame(touched: TouchedObject, points_mm: F64, hand_T_sensor: Rigid) -> HandObject:
    """An object with its points, which are in the hand's frame already."""
    turn = hand_T_sensor.rotation
    extent_mm = np.ptp(points_mm, axis=0) if len(points_mm) else np.abs(turn) @ np.array(touched.extent_mm)
    slide = None if touched.shear_mm is None else rounded_triple(turn[:, :2] @ np.array(touched.shear_mm))
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
    """Round a vector (3,) to what is published."""
    x, y, z = (round(float(value), _DIGITS) + 0.0 for value in vector)  # no -0.0
    return x, y, z


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(float(value), _DIGITS)
