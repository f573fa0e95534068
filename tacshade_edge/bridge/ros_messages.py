"""A sensor's messages as ROS 2 transports them: CDR (XCDR1, little-endian) with its 4-byte header.

Lengths in m, forces in N, torques in N·m, quaternions x, y, z, w (REP 103). A frame's name ends in
the sensor's own ROS name and its part; the sensor's axes are those of an optical frame (x along the
image's columns, y along its rows, z away from the camera), hence the suffix. Stamps are capture
times.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from tacshade_edge.types import U8
from tacshade_edge.wire.binary import CloudMessage, HeightMessage
from tacshade_edge.wire.sensor_topics import TouchNumbers

M_PER_MM: Final = 0.001
Frame = Literal["base", "flange", "sensor_optical"]

# The first two bytes say little-endian CDR without parameter lists; the others are options, unused.
_ENCAPSULATION: Final = b"\0\1\0\0"
# `sec` is an int32 in ROS; a board's clock may be set to any time.
_SEC_MAX: Final = 2**31 - 1
_FLOAT32, _UINT32 = 7, 6
_POINT: Final = np.dtype([("xyz", "<f4", 3), ("label", "<u4")])
_FIELDS: Final = (
    ("x", 0, _FLOAT32),
    ("y", 4, _FLOAT32),
    ("z", 8, _FLOAT32),
    ("label", 12, _UINT32),
)
_FORCE: Final = ("force_x_n", "force_y_n", "force_z_n")
_TORQUE: Final = ("torque_x_nmm", "torque_y_nmm", "torque_z_nmm")


@dataclass(frozen=True, slots=True)
class RosType:
    """A message type and the hash of its definition (REP 2011), as in Jazzy and later."""

    name: str
    rihs01: str


IMAGE: Final = RosType(
    "sensor_msgs/msg/Image",
    "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
)
CLOUD: Final = RosType(
    "sensor_msgs/msg/PointCloud2",
    "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
)
WRENCH: Final = RosType(
    "geometry_msgs/msg/WrenchStamped",
    "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
)
TRANSFORMS: Final = RosType(
    "tf2_msgs/msg/TFMessage",
    "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
)
DIAGNOSTICS: Final = RosType(
    "diagnostic_msgs/msg/DiagnosticArray",
    "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
)


@dataclass(frozen=True, slots=True)
class Transform:
    """Where a frame is in its parent: x, y, z in mm and the quaternion w, x, y, z."""

    seven: Sequence[float]
    wall_ns: int
    parent: str
    child: str


Level = Literal[0, 1, 2, 3]
OK: Final[Level] = 0
WARN: Final[Level] = 1
ERROR: Final[Level] = 2
STALE: Final[Level] = 3


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """How a sensor is, for ``diagnostic_msgs/DiagnosticStatus``."""

    level: Level
    name: str
    message: str
    hardware_id: str
    values: Mapping[str, str]


class _Cdr:
    """Appends values, each aligned to its own size after the header."""

    def __init__(self) -> None:
        self._bytes = bytearray(_ENCAPSULATION)

    def _put(self, code: str, size: int, values: tuple[float, ...]) -> None:
        self._bytes += bytes((len(_ENCAPSULATION) - len(self._bytes)) % size)
        self._bytes += struct.pack(f"<{len(values)}{code}", *values)

    def u8(self, value: int) -> None:
        self._bytes.append(value)

    def u32(self, *values: int) -> None:
        self._put("I", 4, values)

    def f64(self, *values: float) -> None:
        self._put("d", 8, values)

    def text(self, text: str) -> None:
        data = text.encode() + b"\0"
        self.u32(len(data))
        self._bytes += data

    def octets(self, data: memoryview) -> None:
        self.u32(data.nbytes)
        self._bytes += data

    def header(self, wall_ns: int, frame_id: str) -> None:
        sec, nanosec = divmod(wall_ns, 1_000_000_000)
        self.u32(min(sec, _SEC_MAX), nanosec)
        self.text(frame_id)

    def payload(self) -> bytearray:
        return self._bytes


def frame_name(ros_name: str, frame: Frame) -> str:
    """The name of a frame of this sensor; each sensor has its own base, as their robots may
    differ.
    """
    return f"{ros_name}_{frame}"


def height(message: HeightMessage, frame_id: str) -> bytearray:
    """The height map as an Image, ``32FC1``: h in m at each cell, NaN outside the disc, and
    everywhere in a frame that could not be used.
    """
    # The 0 in the message is marked as unknown by a flag, which an image lacks.
    factor = np.float32(math.nan if message.invalid else M_PER_MM)
    height_m = np.multiply(message.height_mm, factor, dtype="<f4")
    rows, cols = height_m.shape
    return _image(message.wall_ns, frame_id, (rows, cols), "32FC1", height_m.data)


def camera(grey: U8, wall_ns: int, frame_id: str) -> bytearray:
    """The camera's picture (rows, cols) as an Image, ``8UC1``."""
    rows, cols = grey.shape
    return _image(wall_ns, frame_id, (rows, cols), "8UC1", np.ascontiguousarray(grey).data)


def _image(
    wall_ns: int, frame_id: str, shape: tuple[int, int], encoding: str, data: memoryview
) -> bytearray:
    rows, cols = shape
    cdr = _Cdr()
    cdr.header(wall_ns, frame_id)
    cdr.u32(rows, cols)
    cdr.text(encoding)
    cdr.u8(0)
    cdr.u32(data.nbytes // rows)
    cdr.octets(data)
    return cdr.payload()


def cloud(message: CloudMessage, frame_id: str) -> bytearray:
    """The cloud as a PointCloud2: x, y, z in m, and as `label` the number of each point's object,
    from 1.
    """
    points = np.empty(len(message.labels), _POINT)
    points["xyz"], points["label"] = message.points_mm * np.float32(M_PER_MM), message.labels
    cdr = _Cdr()
    cdr.header(message.wall_ns, frame_id)
    cdr.u32(1, len(points))
    cdr.u32(len(_FIELDS))
    for name, offset, kind in _FIELDS:
        cdr.text(name)
        cdr.u32(offset)
        cdr.u8(kind)
        cdr.u32(1)
    cdr.u8(0)
    cdr.u32(_POINT.itemsize, points.nbytes)
    cdr.octets(points.data)
    cdr.u8(1)
    return cdr.payload()


def wrench(touch: TouchNumbers, frame_id: str) -> bytearray | None:
    """The forces and torques of a touch as a WrenchStamped, 0 in axes without labels; None if none
    is labelled or one is unknown.
    """
    given = touch.touch or {}
    names = (*_FORCE, *_TORQUE)
    values = [given.get(name, 0.0) for name in names]
    known = [value for value in values if value is not None]
    if len(known) < len(values) or not given.keys() & set(names):
        return None
    cdr = _Cdr()
    cdr.header(touch.wall_ns, frame_id)
    cdr.f64(*known[:3], *(value * M_PER_MM for value in known[3:]))
    return cdr.payload()


def transforms(every: Sequence[Transform]) -> bytearray:
    """A TFMessage."""
    cdr = _Cdr()
    cdr.u32(len(every))
    for one in every:
        x, y, z, qw, qx, qy, qz = one.seven
        cdr.header(one.wall_ns, one.parent)
        cdr.text(one.child)
        cdr.f64(x * M_PER_MM, y * M_PER_MM, z * M_PER_MM, qx, qy, qz, qw)
    return cdr.payload()


def diagnostics(wall_ns: int, every: Iterable[Diagnosis]) -> bytearray:
    """A DiagnosticArray."""
    found = tuple(every)
    cdr = _Cdr()
    cdr.header(wall_ns, "")
    cdr.u32(len(found))
    for one in found:
        cdr.u8(one.level)
        for text in (one.name, one.message, one.hardware_id):
            cdr.text(text)
        cdr.u32(len(one.values))
        for name, value in one.values.items():
            cdr.text(name)
            cdr.text(value)
    return cdr.payload()
