"""What sensors and hands publish: the type of each topic's JSON, with its bounds,
and the table of all topics.

Daemons fill in these types, and subscribers decode them;
anything that no daemon publishes is rejected.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, TypeVar, get_args

from msgspec import Meta

from ..errors import DecodeError
from ..quoting import quoted
from ..rigid import from_seven
from ..types import Disc, Geometry, Skin
from .codec import decode_json, decode_object
from .wire_format import CloudMessage, HeightMessage, ShearMessage, SigmaMessage, decode

State = Literal["online", "degraded", "stopped", "offline"]
STATES: Final[tuple[State, ...]] = get_args(State)
ALIVE: Final = ("online", "degraded")
T = TypeVar("T")

Count = Annotated[int, Meta(ge=0)]  # below 2^64, as `codec` requires
_Code = Annotated[str, Meta(pattern=r"\A[a-z0-9_]{0,64}\Z")]
_Key = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9_.-]{1,64}\Z")]
_Rate = Annotated[float, Meta(ge=0, le=1e9)]
_Number = Annotated[float, Meta(ge=-1e6, le=1e6)]
_Pose = tuple[_Number, _Number, _Number, _Number, _Number, _Number, _Number]
_Numbers = Annotated[dict[_Key, _Number | None], Meta(max_length=64)]
_Sigmas = Annotated[dict[_Key, Annotated[float, Meta(ge=0, le=1e6)] | None], Meta(max_length=64)]
_Counts = Annotated[dict[_Key, Count], Meta(max_length=64)]
_Place = Annotated[float, Meta(ge=-1e7, le=1e7)]
_Slip = Annotated[int, Meta(ge=0, le=2)]  # stick, partial, full
_Px = Annotated[float, Meta(ge=-1e5, le=1e5)]
_SizePx = Annotated[int, Meta(ge=1, le=65535)]

# -- of a sensor -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class InfoGeometry:
    """The geometry that converts pixels to mm.

    A pad has neither `skin_radius_mm` nor `visible_half_angle_deg`.
    """

    skin: Skin = "dome"
    skin_radius_mm: Annotated[float, Meta(ge=0.1, le=1e4)] | None
    camera_distance_mm: Annotated[float, Meta(ge=-1e4, le=1e5)] | None
    visible_half_angle_deg: Annotated[float, Meta(ge=1e-3, le=90)] | None
    visible_radius_mm: Annotated[float, Meta(ge=1e-3, le=1e4)] | None = None
    f_px: float | None = None
    mm_per_px: float | None = None
    row_c: _Px
    col_c: _Px
    radius_px: Annotated[float, Meta(ge=1, le=1e5)]
    image_height_px: _SizePx
    image_width_px: _SizePx
    flange_T_sensor: _Pose
    calibration_crc32: Annotated[int, Meta(ge=0, le=2**32 - 1)]

    def __post_init__(self) -> None:
        from_seven(self.flange_T_sensor)
        d, geometry = self.camera_distance_mm, self.geometry
        if d is not None and not geometry.f_px > 0:
            raise ValueError(f"found a camera distance of {d} mm, expected one behind the skin")

    @property
    def geometry(self) -> Geometry:
        """Skin, camera and disc."""
        disc, d = Disc(self.row_c, self.col_c, self.radius_px), self.camera_distance_mm
        if self.skin == "pad":
            if self.visible_radius_mm is None:
                raise ValueError("found no visible_radius_mm, expected that of a pad")
            return Geometry(math.inf, d, 0.0, disc, self.visible_radius_mm)
        if self.skin_radius_mm is None or self.visible_half_angle_deg is None:
            raise ValueError("found no skin_radius_mm or visible_half_angle_deg, expected a dome's")
        return Geometry(self.skin_radius_mm, d, self.visible_half_angle_deg, disc)


@dataclass(frozen=True, slots=True, kw_only=True)
class Info:
    """``info``: what a subscriber needs to place every pixel of ``height`` in mm.

    `geometry` is None without a calibration; `reason` and its code then give the reason. `profiles`
    are the names that ``req/profile`` accepts, and `choice` is the chosen one of them. `reference`
    is where the reference started and how far it may follow from there; None if it does not follow.
    `fitted` are the profiles whose networks were fitted to this sensor. `hand_id` names the hand
    that the sensor is a finger of, and `hand_T_sensor` (x, y, z in mm, quaternion w, x, y, z) is
    the sensor's pose in it; both are None without a hand.
    """

    version: str = ""
    wire_version: Count = 1
    config_digest: str = ""
    profile: str
    profiles: tuple[str, ...] = ()
    choice: str = ""
    reference: dict[str, Any] | None = None
    geometry: InfoGeometry | None
    fitted: tuple[str, ...] = ()
    hand_id: str | None = None
    hand_T_sensor: _Pose | None = None
    reason: str = ""
    reason_code: _Code = ""

    def __post_init__(self) -> None:
        if self.hand_T_sensor is not None:
            from_seven(self.hand_T_sensor)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """``contact``: flat numbers, None if nothing touches or it is not computed, and codes,
    empty if all is well.

    `contact` is 0 or 1, `objects` the number of objects, `area_mm2` their total area; `x_mm` and
    `y_mm` are the centroid of the largest object. `touched` is 1 if something touches but its depth
    is unknown: `contact` is then 0, and depth, area and volume are None. Shear, twist and slip (0
    stick, 1 partial, 2 full) each come from the object with the largest value. `fps` is the
    delivery rate in 1/s. `t_ns` and `wall_ns` are the capture time, on the daemon's monotonic clock
    and in Unix time.
    """

    t_ns: Count
    seq: Count
    contact: Annotated[int, Meta(ge=0, le=1)]
    depth_max_mm: _Number | None = None
    area_mm2: _Rate | None = None
    volume_mm3: _Rate | None = None
    objects: Count = 0
    x_mm: _Number | None = None
    y_mm: _Number | None = None
    shear_x_mm: _Number | None = None
    shear_y_mm: _Number | None = None
    twist_deg: _Number | None = None
    slip: _Slip | None = None
    slip_mm_s: _Number | None = None
    fps: _Rate | None = None
    reason_code: _Code = ""
    degraded_code: _Code = ""
    wall_ns: Count = 0
    touched: Annotated[int, Meta(ge=0, le=1)] = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchNumbers:
    """``touch``: each quantity and its standard deviation, in the unit of its name,
    and why some or all are unknown.

    Both mappings have the same names, and are None without contact.
    """

    t_ns: Count
    seq: Count
    wall_ns: Count = 0
    touch: _Numbers | None
    touch_sigma: _Sigmas | None
    reason: str = ""
    reason_code: _Code = ""

    def __post_init__(self) -> None:
        if (self.touch or {}).keys() != (self.touch_sigma or {}).keys():
            raise ValueError("found other names in touch_sigma than in touch")


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipEvent:
    """``event/slip``: the object `id` began to slide at x, y in the sensor frame,
    this fast over the skin.
    """

    t_ns: Count
    seq: Count
    id: Count | None = None
    x_mm: _Number
    y_mm: _Number
    slip_mm_s: _Number | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectEvent:
    """``event/object``: the object `label` of the frame is the taught object `name`,
    this probably.
    """

    name: _Key
    probability: Annotated[float, Meta(ge=0, le=1)]
    label: Count
    t_ns: Count
    seq: Count
    wall_ns: Count = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactEvent:
    """``event/contact``: contact `id` has begun (``new``), goes on (``update``,
    once a second) or has ended.

    The values are the greatest since `start_ns`: of depth, volume, length of the mean shear, slip
    and number of objects. They are None while none is known.
    """

    type: Literal["new", "update", "end"]
    id: Count
    t_ns: Count
    wall_ns: Count = 0
    start_ns: Count
    end_ns: Count | None = None
    depth_max_mm: _Number | None = None
    volume_mm3: _Rate | None = None
    shear_mm: _Rate | None = None
    slip: _Slip | None = None
    objects: Count | None = None


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Percentiles of times in ms."""

    p50: _Rate
    p99: _Rate


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """``health`` of a sensor: the counts and measures that every sensor has;
    the rest is for people.
    """

    uptime_s: _Rate
    frames: _Counts
    source_dropped: Count
    capture_fps: _Rate
    delivered_fps: _Rate
    published_fps: _Rate
    latency_ms: Percentiles | None
    stages_ms: Annotated[dict[_Key, Percentiles], Meta(max_length=64)]
    mqtt: _Counts
    recorder: _Counts
    invalid_reason_code: _Code = ""
    degraded_reason_code: _Code = ""
    wall_ns: Count = 0
    touched_frames: Count = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class StitchedMap:
    """``map/revision`` and ``map/final``: extent along x and y of the base frame, range of heights,
    and points.

    `revision` counts the presses and the end; `used` is the number of presses in the map, `points`
    that of points in ``map/cloud``, `spacing_mm` apart. An empty map has no heights. `folder` holds
    the final map's files on the daemon's machine; it is empty before the end.
    """

    name: str
    revision: Count
    presses: Count
    used: Count
    x0_mm: _Place
    y0_mm: _Place
    width_mm: _Place
    length_mm: _Place
    z_min_mm: _Place | None
    z_max_mm: _Place | None
    area_mm2: _Rate
    points: Count
    spacing_mm: _Place
    folder: str = ""


@dataclass(frozen=True, slots=True)
class Status:
    """``status/<part>``, without the part's own details; an empty payload gives empty fields."""

    state: str = ""
    reason: str | None = ""
    reason_code: _Code | None = ""


# -- of a hand: lengths in mm, vectors along the hand's axes ---------------------------------------

FingerState = Literal["contact", "free", "away"]
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
    slip: _Slip | None
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
        found = (
            o.motion
            for finger in self.fingers.values()
            for o in finger.objects
            if o.motion is not None
        )
        return next(found, None)


@dataclass(frozen=True, slots=True, kw_only=True)
class HandHealth:
    """``health`` of a hand: how many messages of each finger it received,
    and how many were damaged.
    """

    wall_ns: Count = 0
    uptime_s: _Rate
    heard: _Counts
    undecodable: Count
    mqtt: _Counts


# -- the topics ------------------------------------------------------------------------------------

_JSON: Final = "application/json"
_JPEG: Final = b"\xff\xd8"
PREVIEW_BYTES_MAX: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class Topic:
    """How to decode a topic's payload, and its MQTT 5 content type.

    `newest_wins` states whether only the newest of its messages is of use,
    so that a reader need not keep more.
    """

    decode: Callable[[str, bytes], Any]
    content_type: str = _JSON
    newest_wins: bool = False


def _json(kind: type, *, newest_wins: bool = False) -> Topic:
    return Topic(lambda part, payload: decode_json(part, payload, kind), newest_wins=newest_wins)


def _binary(kind: type, name: str) -> Topic:
    def read(part: str, payload: bytes) -> Any:
        message = decode(payload)
        if not isinstance(message, kind):
            raise DecodeError(
                f"{part}: found a {type(message).__name__}, expected a {kind.__name__}"
            )
        return message

    return Topic(read, f"application/vnd.tacshade.{name}", newest_wins=True)


def decode_status(topic: str, payload: bytes) -> Status:
    """Decode a ``status/<part>``. Raises DecodeError."""
    return decode_json(topic, payload or b"{}", Status)


def decode_state(payload: bytes) -> State:
    """Decode a ``state``. Raises DecodeError."""
    for state in STATES:
        if payload == state.encode():
            return state
    found = quoted(payload[:60].decode(errors="replace"))
    raise DecodeError(f"state: found {found}, expected one of {', '.join(STATES)}")


def decode_preview(_part: str, payload: bytes) -> bytes:
    """Check a ``preview``, which is a JPEG image. Raises DecodeError."""
    if len(payload) > PREVIEW_BYTES_MAX or not payload.startswith(_JPEG):
        raise DecodeError(
            f"preview: found a payload of {len(payload)} bytes, "
            f"expected a JPEG image of at most {PREVIEW_BYTES_MAX} bytes"
        )
    return payload


_OF_BOTH: Final = {
    "state": Topic(lambda _part, payload: decode_state(payload), "text/plain"),
    "instance": Topic(decode_object),
}
OF_SENSORS: Final[dict[str, Topic]] = {
    **_OF_BOTH,
    "height": _binary(HeightMessage, "height"),
    "cloud": _binary(CloudMessage, "cloud"),
    "shear": _binary(ShearMessage, "shear"),
    "sigma": _binary(SigmaMessage, "sigma"),
    "map/cloud": _binary(CloudMessage, "cloud"),
    "contact": _json(Contact, newest_wins=True),
    "touch": _json(TouchNumbers, newest_wins=True),
    "event/slip": _json(SlipEvent),
    "event/contact": _json(ContactEvent),
    "event/object": _json(ObjectEvent),
    "health": _json(Health, newest_wins=True),
    "info": _json(Info),
    "map/revision": _json(StitchedMap, newest_wins=True),
    "map/final": _json(StitchedMap),
    "preview": Topic(decode_preview, "image/jpeg", newest_wins=True),
    "status/": Topic(decode_status),
    "res/": Topic(decode_object),
}
"""The topics below ``tacshade/SENSOR/``; one that ends in a slash stands for all below it."""
OF_HANDS: Final[dict[str, Topic]] = {
    **_OF_BOTH,
    "objects": _json(HandObjects, newest_wins=True),
    "health": _json(HandHealth, newest_wins=True),
}
"""The topics below ``tacshade/hand/HAND/``."""


def _decoder(what: str, kind: type[T]) -> Callable[[bytes], T]:
    def read(payload: bytes) -> T:
        return decode_json(what, payload, kind)

    read.__doc__ = f"Decode the payload of ``{what}`` as `{kind.__name__}`. Raises DecodeError."
    return read


decode_info = _decoder("info", Info)
decode_contact = _decoder("contact", Contact)
decode_touch = _decoder("touch", TouchNumbers)
decode_slip = _decoder("event/slip", SlipEvent)
decode_contact_event = _decoder("event/contact", ContactEvent)
decode_object_event = _decoder("event/object", ObjectEvent)
decode_health = _decoder("health", Health)
decode_map = _decoder("map", StitchedMap)
decode_hand = _decoder("objects", HandObjects)
decode_hand_health = _decoder("health", HandHealth)
