"""Decodes a topic's payload to a value, and converts a height map to points in mm."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Final

from ..errors import DecodeError
from ..quoting import shown
from ..sensor.geometry.disc import Grid, disc_rays, skin_points
from ..types.geometry import F32
from .sensor_topics import InfoGeometry
from .topics import OF_HANDS, OF_SENSORS
from .wire_format import HeightMessage

_TOPIC: Final = re.compile(r"tacshade/((?!hand/)[A-Za-z0-9_-]{1,64}|hand/[A-Za-z0-9_-]{1,64})/(.+)")


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """A decoded message.

    Attributes
    ----------
    name : str
        The sensor's name, or ``hand/`` and the hand's name.
    part : str
        The rest of the topic, such as ``height`` or ``status/camera``.
    value : object
        A `HeightMessage`, `CloudMessage`, `ShearMessage`, `SigmaMessage`, `Contact`,
        `TouchNumbers`, `SlipEvent`, `ContactEvent`, `ObjectEvent`, `Health`, `Info`, `Status`,
        `StitchedMap`, `HandObjects` or `HandHealth`; a string for ``state``, a JPEG's bytes for
        ``preview``, a dict for other JSON.
    retained : bool
        The broker had retained it from before this subscription.
    """

    name: str
    part: str
    value: Any
    retained: bool = False


def decode_message(topic: str, payload: bytes, *, retained: bool = False) -> Message:
    """Decode a payload by its topic, such as ``tacshade/left-index/height``.

    Raises
    ------
    DecodeError
        The topic is not a sensor's or hand's, or no daemon publishes such a payload there.
    """
    found = _TOPIC.fullmatch(topic)
    if found is None:
        raise DecodeError(
            f"topic {shown(topic)}: expected tacshade/SENSOR/... or tacshade/hand/HAND/..."
        )
    name, part = found.groups()
    topics = OF_HANDS if name.startswith("hand/") else OF_SENSORS
    known = topics.get(part) or topics.get(f"{part.partition('/')[0]}/")
    if known is None:
        raise DecodeError(f"topic {shown(topic)}: expected one that docs/reference/mqtt.md lists")
    return Message(name, part, known.decode(part, payload), retained)


def skin_mm(height: HeightMessage, geometry: InfoGeometry) -> F32:
    """The skin point of each cell (the paper's eq. 2, also for a pinhole camera).

    Parameters
    ----------
    height : HeightMessage
    geometry : InfoGeometry
        From the same sensor's ``info``.

    Returns
    -------
    float32 (rows, cols, 3)
        x, y, z in the sensor frame in mm; NaN outside the disc.

    Raises
    ------
    DecodeError
        The height comes from another calibration than the geometry: wait for the next ``info``.
    """
    if height.calibration_crc32 != geometry.calibration_crc32:
        found = (
            f"{height.calibration_crc32:08x}, expected {geometry.calibration_crc32:08x} as in info"
        )
        raise DecodeError(f"height: found calibration {found}")
    rows, cols = height.height_mm.shape
    grid = Grid(rows, cols, height.row0, height.col0, height.step_px)
    return skin_points(height.height_mm, disc_rays(grid, geometry.geometry), geometry.geometry)
