"""Decode ``tacshade/hand/<hand-id>/objects``, which reports what all fingers of a hand touch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, Literal

from .received import Count
from .strict import Bounds, decode

FingerState = Literal["contact", "free", "away"]
_Value = Annotated[float, Bounds(-1e9, 1e9)]
Triple = tuple[_Value, _Value, _Value]

OBJECTS_MAX: Final = 16
"""Only a finger's largest objects are sent: five fingers publish at most 29 kB, and as much again with motions."""
FINGERS_MAX: Final = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class Unobservable:
    """A motion that the fingers cannot observe: a rotation about a line, or a translation along it.

    Attributes
    ----------
    axis : 3 floats
        Unit vector.
    through_mm : 3 floats or None
        A point on the line of rotation; None for a translation.
    """

    axis: Triple
    through_mm: Triple | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """The motion of the held object since the grasp: a point at p has moved to R (p - about) + about + translation.

    Attributes
    ----------
    since_ns : int
        Capture time of the frame in which the hand grasped the object.
    about_mm, translation_mm : 3 floats
        A point amid the fingers' patches, and how far it has moved.
    rotation_deg : 3 floats
        Rotation vector of R.
    covariance : 36 floats
        6x6, row by row, of `translation_mm` and of a small rotation in degrees applied after R.
    unobservable : tuple of Unobservable
        Motions that are 0 in the estimate and large in the covariance.
    left_out : tuple of str
        Fingers over which the object slips.
    """

    since_ns: Count
    about_mm: Triple
    translation_mm: Triple
    rotation_deg: Triple
    covariance: Annotated[tuple[_Value, ...], Bounds(36, 36)]
    unobservable: Annotated[tuple[Unobservable, ...], Bounds(most=6)] = ()
    left_out: Annotated[tuple[str, ...], Bounds(most=FINGERS_MAX)] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class HandObject:
    """An object that a finger touches; all lengths in mm, all vectors along the hand's axes.

    Attributes
    ----------
    id : int or None
        Constant while this finger touches the object.
    centroid_mm, extent_mm : 3 floats
        Mean, and max - min, of the skin points that touch the object.
    normal : 3 floats
        Unit normal of the plane through these points, pointing away from the finger's camera.
    depth_max_mm, area_mm2 : float
    shear_mm : 3 floats or None
        Mean shear of the skin under the object, in the finger's x, y plane; None if not reported.
    twist_deg : float or None
        Twist about the finger's own z axis.
    slip : int or None
        0 stick, 1 partial, 2 full.
    slip_mm_s : float or None
    motion : Motion or None
        Motion of the object that the whole hand holds; None if no shear is reported, and from a finger to its hand.
    """

    id: int | None
    centroid_mm: Triple
    extent_mm: Triple
    normal: Triple
    depth_max_mm: _Value
    area_mm2: _Value
    shear_mm: Triple | None
    twist_deg: _Value | None
    slip: Annotated[int, Bounds(0, 2)] | None
    slip_mm_s: _Value | None
    motion: Motion | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Finger:
    """A finger's latest report.

    Attributes
    ----------
    state : str
        ``contact``, ``free``, or ``away``: its contacts are unknown, and `reason_code` gives the reason.
    t_ns : int or None
        Capture time of its frame, on the clock that all fingers share; None if the report is not from a frame.
    age_ms : float or None
        Age of the frame when the hand published it.
    seq : int or None
        Sequence number of the frame.
    reason_code, degraded_code : str
        Codes of `reasons.ReasonCode`; empty when all is well.
    axis : 3 floats or None
        The finger's z axis: shear is perpendicular to it, twist is about it. None if the report is not from a frame.
    margin : float or None
        Smallest margin of its objects, 1 firm to 0 sliding; None without contact, or if no shear is reported.
    objects : tuple of HandObject
        Largest first, at most `OBJECTS_MAX`; empty unless `state` is ``contact``.
    """

    state: FingerState
    t_ns: Count | None = None
    age_ms: _Value | None = None
    seq: Count | None = None
    reason_code: str = ""
    degraded_code: str = ""
    axis: Triple | None = None
    margin: Annotated[float, Bounds(0, 1)] | None = None
    objects: Annotated[tuple[HandObject, ...], Bounds(most=OBJECTS_MAX)] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class HandObjects:
    """One ``objects`` message: every finger of the hand, by sensor id.

    Attributes
    ----------
    t_ns, wall_ns : int
        When the message was assembled, on the fingers' clock and in Unix time.
    seq : int
        Number of the message, counted from 0 since the hand's process started.
    fingers : dict of str to Finger
        Fingers in the order of the settings.
    """

    t_ns: Count
    wall_ns: Count
    seq: Count
    fingers: Annotated[dict[str, Finger], Bounds(most=FINGERS_MAX)]

    @property
    def motion(self) -> Motion | None:
        """Motion of the object that the hand holds; None if no finger that touches it reports shear."""
        found = (o.motion for finger in self.fingers.values() for o in finger.objects if o.motion is not None)
        return next(found, None)


def decode_hand(payload: bytes) -> HandObjects:
    """Decode an ``objects`` payload; unknown keys are ignored. Raises DecodeError."""
    return decode("objects", payload, HandObjects)
