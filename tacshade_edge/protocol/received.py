"""``info``, ``contact``, ``touch``, ``health``, ``state`` and ``status/<part>`` as a subscriber understands them.

Keys that it does not know are ignored; what no daemon publishes is refused (`protocol.strict`).
"""

from __future__ import annotations

from typing import Annotated, Final, Literal, get_args

import msgspec
from msgspec import Meta

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.strict import decode
from tacshade_edge.quoting import quoted
from tacshade_edge.rigid import from_seven
from tacshade_edge.types import Disc, Geometry

State = Literal["online", "degraded", "stopped", "offline"]
STATES: Final[tuple[State, ...]] = get_args(State)
ALIVE: Final = ("online", "degraded")

Count = Annotated[int, Meta(ge=0)]  # below 2^64 as every integer of `strict`
_Code = Annotated[str, Meta(pattern=r"\A[a-z0-9_]{0,64}\Z")]
_Key = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9_.-]{1,64}\Z")]
_Rate = Annotated[float, Meta(ge=0, le=1e9)]
_Mm = Annotated[float, Meta(ge=-1e6, le=1e6)]
_Numbers = Annotated[dict[_Key, Annotated[float, Meta(ge=-1e6, le=1e6)] | None], Meta(max_length=64)]
_Sigmas = Annotated[dict[_Key, Annotated[float, Meta(ge=0, le=1e6)] | None], Meta(max_length=64)]
_Counts = Annotated[dict[_Key, Count], Meta(max_length=64)]


class InfoGeometry(msgspec.Struct, frozen=True):
    """What places a pixel in mm."""

    skin_radius_mm: Annotated[float, Meta(ge=0.1, le=1e4)]
    camera_distance_mm: Annotated[float, Meta(gt=1e-6, le=1e5)] | None
    visible_half_angle_deg: Annotated[float, Meta(ge=1e-3, le=90)]
    row_c: Annotated[float, Meta(ge=-1e5, le=1e5)]
    col_c: Annotated[float, Meta(ge=-1e5, le=1e5)]
    radius_px: Annotated[float, Meta(ge=1, le=1e5)]
    image_height_px: Annotated[int, Meta(ge=1, le=65535)]
    image_width_px: Annotated[int, Meta(ge=1, le=65535)]
    flange_T_sensor: tuple[_Mm, _Mm, _Mm, _Mm, _Mm, _Mm, _Mm]
    calibration_crc32: Annotated[int, Meta(ge=0, lt=2**32)]

    def __post_init__(self) -> None:
        from_seven(self.flange_T_sensor)

    @property
    def geometry(self) -> Geometry:
        """Skin, camera and disc."""
        disc = Disc(self.row_c, self.col_c, self.radius_px)
        return Geometry(self.skin_radius_mm, self.camera_distance_mm, self.visible_half_angle_deg, disc)


class Info(msgspec.Struct, frozen=True):
    """A decoded ``info``; `geometry` is None before there is a calibration, for the `reason`."""

    geometry: InfoGeometry | None
    profile: str
    reason: str = ""


class Contact(msgspec.Struct, frozen=True):
    """A decoded ``contact``, without the numbers of its objects. The codes are empty where all is well."""

    seq: Count
    t_ns: Count
    contact: Annotated[int, Meta(ge=0, le=1)]
    wall_ns: Count = 0
    reason_code: _Code = ""
    degraded_code: _Code = ""


class TouchNumbers(msgspec.Struct, frozen=True):
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


class Percentiles(msgspec.Struct, frozen=True):
    """Of times in ms."""

    p50: _Rate
    p99: _Rate


class Health(msgspec.Struct, frozen=True):
    """A decoded ``health``: what is counted and measured of every sensor; the rest of it is for people."""

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


class Status(msgspec.Struct, frozen=True):
    """A decoded ``status/<part>``, without the part's own details; an empty payload is one of nothing."""

    state: str = ""
    reason: str | None = ""


def decode_info(payload: bytes) -> Info:
    """Understand an ``info``. Raises DecodeError."""
    return decode("info", payload, Info)


def decode_contact(payload: bytes) -> Contact:
    """Understand a ``contact``. Raises DecodeError."""
    return decode("contact", payload, Contact)


def decode_touch(payload: bytes) -> TouchNumbers:
    """Understand a ``touch``. Raises DecodeError."""
    return decode("touch", payload, TouchNumbers)


def decode_health(payload: bytes) -> Health:
    """Understand a ``health``. Raises DecodeError."""
    return decode("health", payload, Health)


def decode_status(topic: str, payload: bytes) -> Status:
    """Understand a ``status/<part>``. Raises DecodeError."""
    return decode(topic, payload or b"{}", Status)


def decode_state(payload: bytes) -> State:
    """Understand a ``state``. Raises DecodeError."""
    for state in STATES:
        if payload == state.encode():
            return state
    found = quoted(payload[:60].decode(errors="replace"))
    raise DecodeError(f"state: found {found}, expected {', '.join(STATES)}")
