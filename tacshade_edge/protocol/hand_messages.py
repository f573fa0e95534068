"""``tacshade/hand/<hand-id>/objects`` as a subscriber understands it: what all fingers of a hand touch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, Literal

from .received import Count
from .strict import Bounds, decode

FingerState = Literal["contact", "free", "away"]
_Value = Annotated[float, Bounds(-1e9, 1e9)]
Triple = tuple[_Value, _Value, _Value]

OBJECTS_MAX: Final = 16
"""The greatest of a finger: what five fingers publish stays within 29 kB, and as much again with its motion."""
FINGERS_MAX: Final = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class Unobservable:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
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
    covariance: Annotated[tuple[_Value, ...], Bounds(36, 36)]
    unobservable: Annotated[tuple[Unobservable, ...], Bounds(most=6)] = ()
    left_out: Annotated[tuple[str, ...], Bounds(most=FINGERS_MAX)] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class HandObject:
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
    slip: Annotated[int, Bounds(0, 2)] | None
    slip_mm_s: _Value | None
    motion: Motion | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Finger:
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
    margin: Annotated[float, Bounds(0, 1)] | None = None
    objects: Annotated[tuple[HandObject, ...], Bounds(most=OBJECTS_MAX)] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class HandObjects:
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
    fingers: Annotated[dict[str, Finger], Bounds(most=FINGERS_MAX)]

    @property
    def motion(self) -> Motion | None:
        """Of the object that the hand holds; None where no finger that touches it reports shear."""
        found = (o.motion for finger in self.fingers.values() for o in finger.objects if o.motion is not None)
        return next(found, None)


def decode_hand(payload: bytes) -> HandObjects:
    """Understand an ``objects`` payload; keys that are not known are ignored. Raises DecodeError."""
    return decode("objects", payload, HandObjects)
