"""``info`` and ``contact`` as a subscriber understands them; keys that it does not know are ignored."""

from __future__ import annotations

from typing import TypeVar

import msgspec

from tacshade_edge.errors import DecodeError
from tacshade_edge.types import Disc, Geometry

T = TypeVar("T")


class InfoGeometry(msgspec.Struct, frozen=True):
    """What places a pixel in mm."""

    skin_radius_mm: float
    camera_distance_mm: float | None
    visible_half_angle_deg: float
    row_c: float
    col_c: float
    radius_px: float
    image_height_px: int
    image_width_px: int
    flange_T_sensor: tuple[float, float, float, float, float, float, float]
    calibration_crc32: int

    @property
    def geometry(self) -> Geometry:
        """Skin, camera and disc."""
        disc = Disc(self.row_c, self.col_c, self.radius_px)
        return Geometry(self.skin_radius_mm, self.camera_distance_mm, self.visible_half_angle_deg, disc)


class Info(msgspec.Struct, frozen=True):
    """A decoded ``info``; `geometry` is None before there is a calibration, for the `reason`."""

    geometry: InfoGeometry | None = None
    profile: str = ""
    reason: str = ""


class Contact(msgspec.Struct, frozen=True):
    """A decoded ``contact``, without the numbers of its objects. The codes are empty where all is well."""

    seq: int
    t_ns: int
    contact: int
    wall_ns: int = 0
    reason_code: str = ""
    degraded_code: str = ""


def decode_info(payload: bytes) -> Info:
    """Understand an ``info``. Raises DecodeError."""
    return _decoded("info", payload, Info)


def decode_contact(payload: bytes) -> Contact:
    """Understand a ``contact``. Raises DecodeError."""
    return _decoded("contact", payload, Contact)


def _decoded(topic: str, payload: bytes, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(payload, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise DecodeError(f"{topic}: {error}, expected what docs/mqtt.md says") from error
