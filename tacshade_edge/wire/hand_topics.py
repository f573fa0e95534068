"""``objects``: what a hand publishes; lengths in mm, vectors along the hand's axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, Literal

from msgspec import Meta

from .bounds import Count, SlipCode

FingerState = Literal["contact", "free", "away"]
# Wide: robots place a hand anywhere, and covariances are large where nothing is observed.
_Value = Annotated[float, Meta(ge=-1e9, le=1e9)]
Triple = tuple[_Value, _Value, _Value]

OBJECTS_MAX: Final = 16
"""Only a finger's largest objects are sent: five fingers publish at most 29 kB,
and as much again with motions.
"""
FINGERS_MAX: Final = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class Unobservable:
    """A motion that the fingers cannot observe: a rotation about a line, or a translation along it.

    `axis` is a unit vector, `through_mm` a point on the line of rotation, None for a translation.
    """

    axis: Triple
    through_mm: Triple | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """The motion of the held object since the grasp:
    a point at p has moved to R (p - about) + about + translation.

    `since_ns` is the capture time of the frame in which the hand grasped the object, `about_mm` a
    point amid the fingers' patches, `rotation_deg` the rotation vector of R, `covariance` 6x6, row
    by row, of `translation_mm` and of a small rotation in degrees applied after R. `unobservable`
    motions are 0 in the estimate and large in the covariance. The object slips over the fingers in
    `left_out`.
    """

    since_ns: Count
    about_mm: Triple
    translation_mm: Triple
    rotation_deg: Triple
    covariance: Annotated[tuple[_Value, ...], Meta(min_length=36, max_length=36)]
    unobservable: Annotated[tuple[Unobservable, ...], Meta(max_length=6)] = ()
    left_out: Annotated[tuple[str, ...], Meta(max_length=FINGERS_MAX)] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class HandObject:
    """An object that a finger touches; all lengths in mm, all vectors along the hand's axes.

    `id` stays while this finger touches the object. `centroid_mm` and `extent_mm` are the mean, and
    max - min, of the skin points that touch it, `normal` the unit normal of the plane through them,
    away from the finger's camera. `shear_mm` is the mean shear of the skin under the object, in the
    finger's x, y plane, `twist_deg` the twist about the finger's z axis, `slip` 0 stick, 1 partial,
    2 full; each is None if not reported. `motion` is that of the object that the whole hand holds;
    None if no shear is reported, and from a finger to its hand.
    """

    id: int | None
    centroid_mm: Triple
    extent_mm: Triple
    normal: Triple
    depth_max_mm: _Value
    area_mm2: _Value
    shear_mm: Triple | None
    twist_deg: _Value | None
    slip: SlipCode | None
    slip_mm_s: _Value | None
    motion: Motion | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Finger:
    """A finger's latest report.

    `state` is ``contact``, ``free``, or ``away``: its contacts are unknown. `touched`: something
    touches, but its depth is unknown; `state` is then ``free``, and there are no objects. The codes
    are those of `reasons.ReasonCode`, empty when all is well. `t_ns` is the capture time of its
    frame, on the clock that all fingers share, `seq` its number, `age_ms` its age when the hand
    published it, `axis` the finger's z axis: shear is perpendicular to it, twist is about it. These
    are None if the report is not from a frame. `objects` are the largest first, at most
    `OBJECTS_MAX`.
    """

    state: FingerState
    t_ns: Count | None = None
    age_ms: _Value | None = None
    seq: Count | None = None
    reason_code: str = ""
    degraded_code: str = ""
    axis: Triple | None = None
    objects: Annotated[tuple[HandObject, ...], Meta(max_length=OBJECTS_MAX)] = ()
    touched: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class HandObjects:
    """One ``objects`` message: every finger of the hand, by sensor id,
    in the order of the settings.

    `t_ns` and `wall_ns` are when it was assembled, on the fingers' clock and in Unix time; `seq`
    counts from 0 since the hand's process started.
    """

    t_ns: Count
    wall_ns: Count
    seq: Count
    fingers: Annotated[dict[str, Finger], Meta(max_length=FINGERS_MAX)]

    @property
    def motion(self) -> Motion | None:
        """Motion of the object that the hand holds; None if no finger
        that touches it reports shear.
        """
        # A hand holds one object, so all its fingers report the same motion.
        found = (
            o.motion
            for finger in self.fingers.values()
            for o in finger.objects
            if o.motion is not None
        )
        return next(found, None)
