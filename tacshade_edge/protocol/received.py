"""Decode the JSON that sensors and hands publish, and ``state``.

Unknown keys are ignored; anything that no daemon publishes is rejected (`protocol.strict`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, Literal, get_args

from ..errors import DecodeError
from ..quoting import quoted
from ..rigid import from_seven
from ..types import Disc, Geometry
from .strict import Bounds, decode

State = Literal["online", "degraded", "stopped", "offline"]
STATES: Final[tuple[State, ...]] = get_args(State)
ALIVE: Final = ("online", "degraded")

Count = Annotated[int, Bounds(least=0)]  # below 2^64, as `strict` requires
_Code = Annotated[str, Bounds(pattern=r"[a-z0-9_]{0,64}")]
_Key = Annotated[str, Bounds(pattern=r"[A-Za-z0-9_.-]{1,64}")]
_Rate = Annotated[float, Bounds(0, 1e9)]
_Number = Annotated[float, Bounds(-1e6, 1e6)]
_Pose = tuple[_Number, _Number, _Number, _Number, _Number, _Number, _Number]
_Numbers = Annotated[dict[_Key, _Number | None], Bounds(most=64)]
_Sigmas = Annotated[dict[_Key, Annotated[float, Bounds(0, 1e6)] | None], Bounds(most=64)]
_Counts = Annotated[dict[_Key, Count], Bounds(most=64)]
_Place = Annotated[float, Bounds(-1e7, 1e7)]


@dataclass(frozen=True, slots=True)
class InfoGeometry:
    """The geometry that converts pixels to mm."""

    skin_radius_mm: Annotated[float, Bounds(0.1, 1e4)]
    camera_distance_mm: Annotated[float, Bounds(1e-6, 1e5)] | None
    visible_half_angle_deg: Annotated[float, Bounds(1e-3, 90)]
    row_c: Annotated[float, Bounds(-1e5, 1e5)]
    col_c: Annotated[float, Bounds(-1e5, 1e5)]
    radius_px: Annotated[float, Bounds(1, 1e5)]
    image_height_px: Annotated[int, Bounds(1, 65535)]
    image_width_px: Annotated[int, Bounds(1, 65535)]
    flange_T_sensor: _Pose
    calibration_crc32: Annotated[int, Bounds(0, 2**32 - 1)]

    def __post_init__(self) -> None:
        from_seven(self.flange_T_sensor)

    @property
    def geometry(self) -> Geometry:
        """Skin, camera and disc."""
        disc = Disc(self.row_c, self.col_c, self.radius_px)
        return Geometry(self.skin_radius_mm, self.camera_distance_mm, self.visible_half_angle_deg, disc)


@dataclass(frozen=True, slots=True)
class Info:
    """A decoded ``info``.

    Attributes
    ----------
    geometry : InfoGeometry or None
        None without a calibration; `reason` and its code then give the reason.
    hand_id : str or None
        Id of the hand that the sensor is a finger of.
    hand_T_sensor : 7 floats or None
        Pose of the sensor in the hand: x, y, z in mm, quaternion w, x, y, z; None without a hand.
    """

    geometry: InfoGeometry | None
    profile: str
    reason: str = ""
    reason_code: _Code = ""
    version: str = ""
    hand_id: str | None = None
    hand_T_sensor: _Pose | None = None

    def __post_init__(self) -> None:
        if self.hand_T_sensor is not None:
            from_seven(self.hand_T_sensor)


@dataclass(frozen=True, slots=True)
class Contact:
    """A decoded ``contact``; a number is None if nothing touches or it is not computed, a code empty if all is well."""

    seq: Count
    t_ns: Count
    contact: Annotated[int, Bounds(0, 1)]
    wall_ns: Count = 0
    reason_code: _Code = ""
    degraded_code: _Code = ""
    depth_max_mm: _Number | None = None
    area_mm2: _Rate | None = None
    volume_mm3: _Rate | None = None
    objects: Count = 0
    x_mm: _Number | None = None
    y_mm: _Number | None = None
    shear_x_mm: _Number | None = None
    shear_y_mm: _Number | None = None
    twist_deg: _Number | None = None
    slip: Annotated[int, Bounds(0, 2)] | None = None
    slip_mm_s: _Number | None = None
    fps: _Rate | None = None


@dataclass(frozen=True, slots=True)
class TouchNumbers:
    """A decoded ``touch``; both mappings have the same names, and are None without contact."""

    seq: Count
    t_ns: Count
    touch: _Numbers | None
    touch_sigma: _Sigmas | None
    wall_ns: Count = 0
    reason: str = ""
    reason_code: _Code = ""

    def __post_init__(self) -> None:
        if (self.touch or {}).keys() != (self.touch_sigma or {}).keys():
            raise ValueError("found other names in touch_sigma than in touch")


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Percentiles of times in ms."""

    p50: _Rate
    p99: _Rate


@dataclass(frozen=True, slots=True)
class Health:
    """A decoded ``health`` of a sensor: the counts and measures that every sensor has; the rest is for people."""

    uptime_s: _Rate
    frames: _Counts
    source_dropped: Count
    capture_fps: _Rate
    delivered_fps: _Rate
    published_fps: _Rate
    latency_ms: Percentiles | None
    stages_ms: Annotated[dict[_Key, Percentiles], Bounds(most=64)]
    mqtt: _Counts
    recorder: _Counts
    invalid_reason_code: _Code = ""
    degraded_reason_code: _Code = ""
    wall_ns: Count = 0


@dataclass(frozen=True, slots=True)
class HandHealth:
    """A decoded ``health`` of a hand: how many messages of each finger it received, and how many were damaged."""

    uptime_s: _Rate
    heard: _Counts
    undecodable: Count
    mqtt: _Counts
    wall_ns: Count = 0


@dataclass(frozen=True, slots=True)
class SlipEvent:
    """A decoded ``event/slip``: the object `id` began to slide at x, y in the sensor frame."""

    seq: Count
    t_ns: Count
    x_mm: _Number
    y_mm: _Number
    slip_mm_s: _Number | None = None
    id: Count | None = None


@dataclass(frozen=True, slots=True)
class StitchedMap:
    """A decoded ``map/revision`` or ``map/final``.

    Attributes
    ----------
    name : str
        Name of the session.
    revision, presses, used : int
        `revision` counts the presses and the end; `used` is the number of presses in the map.
    x0_mm, y0_mm, width_mm, length_mm : float
        The map's extent along x and y of the base frame.
    z_min_mm, z_max_mm : float or None
        Range of the heights; None for an empty map.
    area_mm2 : float
    points : int
        Number of points in ``map/cloud``.
    spacing_mm : float
        Distance between neighbouring points.
    folder : str
        Folder of the final map's files on the daemon's machine; empty before the end.
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
    """A decoded ``status/<part>``, without the part's own details; an empty payload gives empty fields."""

    state: str = ""
    reason: str | None = ""
    reason_code: _Code | None = ""


def decode_info(payload: bytes) -> Info:
    """Decode an ``info``. Raises DecodeError."""
    return decode("info", payload, Info)


def decode_contact(payload: bytes) -> Contact:
    """Decode a ``contact``. Raises DecodeError."""
    return decode("contact", payload, Contact)


def decode_touch(payload: bytes) -> TouchNumbers:
    """Decode a ``touch``. Raises DecodeError."""
    return decode("touch", payload, TouchNumbers)


def decode_health(payload: bytes) -> Health:
    """Decode a sensor's ``health``. Raises DecodeError."""
    return decode("health", payload, Health)


def decode_hand_health(payload: bytes) -> HandHealth:
    """Decode a hand's ``health``. Raises DecodeError."""
    return decode("health", payload, HandHealth)


def decode_slip(payload: bytes) -> SlipEvent:
    """Decode an ``event/slip``. Raises DecodeError."""
    return decode("event/slip", payload, SlipEvent)


def decode_map(payload: bytes) -> StitchedMap:
    """Decode a ``map/revision`` or ``map/final``. Raises DecodeError."""
    return decode("map", payload, StitchedMap)


def decode_status(topic: str, payload: bytes) -> Status:
    """Decode a ``status/<part>``. Raises DecodeError."""
    return decode(topic, payload or b"{}", Status)


def decode_state(payload: bytes) -> State:
    """Decode a ``state``. Raises DecodeError."""
    for state in STATES:
        if payload == state.encode():
            return state
    found = quoted(payload[:60].decode(errors="replace"))
    raise DecodeError(f"state: found {found}, expected one of {', '.join(STATES)}")
