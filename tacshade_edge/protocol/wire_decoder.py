"""Decode ``height``, ``cloud``, ``shear`` and ``sigma``: binary MQTT payloads, a 96-byte little-endian header and data.

docs/reference/mqtt/frames.md defines the layout, a promise to subscribers: it may only grow. Therefore the decoder
ignores unknown flag bits and reserved bytes and rejects everything else unknown.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np

from ..errors import DecodeError
from ..types import F32, U16, Pose

WIRE_VERSION: Final = 1
HEADER_BYTES: Final = 96
OUTSIDE: Final = -32768
CELLS_MAX: Final = 1 << 22
"""Most cells of a decoded grid, or points of a cloud: a disc of 2048 px with a cell for each pixel."""
PAYLOAD_BYTES_MAX: Final = 14 * CELLS_MAX
"""Size of the largest payload, a cloud of `CELLS_MAX` points."""
_PX_MAX, _MM_MAX = 1e5, 1e7
_STEP_PX_LEAST: Final = 1e-6
_UNIT_OFF_MAX: Final = 1e-2

MAGIC: Final = b"TCSH"
HEIGHT, CLOUD, SHEAR, SIGMA = 1, 2, 3, 4
RAW: Final = 0
CONTACT, INVALID, SATURATED, DEGRADED, POSE = 1, 2, 4, 8, 16

# magic version kind codec flags | seq calibration t wall | rows cols | row0 col0 step scale | pose | payload bytes
HEAD: Final = struct.Struct("<4s4B IIQQ 2H 4f I7f I")
COUNT: Final = struct.Struct("<I")
CHECK: Final = struct.Struct("<II")
_POINT_BYTES, _LABEL_BYTES = 12, 2
_VALUES: Final = {HEIGHT: 1, SHEAR: 2, SIGMA: 1}
"""Number of values per cell of each kind."""


@dataclass(frozen=True, slots=True, eq=False)
class _Message:
    """The fields of every kind.

    Attributes
    ----------
    seq : int
        Frame number modulo 2^32.
    calibration_crc32 : int
    t_ns, wall_ns : int
        Capture time in ns: the sender's CLOCK_MONOTONIC, and Unix time.
    contact, invalid, saturated, degraded : bool
        As in `Reconstruction`; the reasons are in ``health`` and ``status/camera``.
    pose : Pose or None
        ``base_T_flange`` at `t_ns`.
    pose_error_us : int
        Uncertainty in µs of the time of the pose; 0 without a pose.
    """

    seq: int
    calibration_crc32: int
    t_ns: int
    wall_ns: int
    contact: bool
    invalid: bool
    saturated: bool
    degraded: bool
    pose: Pose | None
    pose_error_us: int


@dataclass(frozen=True, slots=True, eq=False)
class _GridMessage(_Message):
    """The grid of the kinds with a value per cell: cell (i, j) is image pixel (row0 + i·step_px, col0 + j·step_px)."""

    row0: float
    col0: float
    step_px: float


@dataclass(frozen=True, slots=True, eq=False)
class HeightMessage(_GridMessage):
    """A decoded ``height``.

    Attributes
    ----------
    height_mm : float32 (rows, cols)
        Radial deformation in mm, positive inwards, in steps of the scale; NaN outside the disc. Read-only.
    """

    height_mm: F32


@dataclass(frozen=True, slots=True, eq=False)
class CloudMessage(_Message):
    """A decoded ``cloud``.

    Attributes
    ----------
    points_mm : float32 (N, 3)
        x, y, z in the sensor frame, in mm. Read-only.
    labels : uint16 (N,)
        Object number of each point, from 1. Read-only.
    """

    points_mm: F32
    labels: U16


@dataclass(frozen=True, slots=True, eq=False)
class ShearMessage(_GridMessage):
    """A decoded ``shear``.

    Attributes
    ----------
    shear_mm : float32 (rows, cols, 2)
        Shear of the skin along x and y in mm, in steps of the scale; NaN outside the disc. Read-only.
    """

    shear_mm: F32


@dataclass(frozen=True, slots=True, eq=False)
class SigmaMessage(_GridMessage):
    """A decoded ``sigma``.

    Attributes
    ----------
    sigma_mm : float32 (rows, cols)
        Standard deviation of the height in mm, in steps of the scale; NaN where nothing touches. Read-only.
    """

    sigma_mm: F32


def decode(data: bytes | bytearray | memoryview) -> HeightMessage | CloudMessage | ShearMessage | SigmaMessage:
    """Decode one ``height``, ``cloud``, ``shear`` or ``sigma`` payload; the result owns its arrays.

    Raises DecodeError if the payload is too short, has an unknown magic, version, kind or codec, a wrong length or CRC,
    more than `CELLS_MAX` cells or points, or a number that no sensor, robot or object has.
    """
    data = bytes(data)
    kind, rows, cols = _check(data)
    fields = HEAD.unpack_from(data)
    flags, seq, calibration, t_ns, wall_ns = fields[4:9]
    row0, col0, step_px, scale_mm, error_us = fields[11:16]
    if kind != CLOUD:
        if not rows * cols:
            raise DecodeError(f"height/cloud payload, byte 32: found {rows} x {cols} cells, expected at least one")
        _check_grid(row0, col0, step_px, scale_mm)
    if flags & POSE:
        _check_pose(fields[16:23])
    common = (
        seq,
        calibration,
        t_ns,
        wall_ns,
        bool(flags & CONTACT),
        bool(flags & INVALID),
        bool(flags & SATURATED),
        bool(flags & DEGRADED),
        Pose(t_ns, *fields[16:23]) if flags & POSE else None,
        error_us if flags & POSE else 0,
    )
    if kind == CLOUD:
        n = rows | cols << 16
        points = np.frombuffer(data, "<f4", 3 * n, HEADER_BYTES).astype(np.float32, copy=False)
        if not (np.abs(points) <= _MM_MAX).all():  # also rejects NaN
            raise DecodeError(
                "height/cloud payload: found a point out of range, "
                f"expected every point within {_MM_MAX:g} mm of the origin"
            )
        labels = np.frombuffer(data, "<u2", n, HEADER_BYTES + _POINT_BYTES * n).astype(np.uint16, copy=False)
        return CloudMessage(*common, points.reshape(n, 3), labels)
    steps = np.frombuffer(data, "<i2", rows * cols * _VALUES[kind], HEADER_BYTES)
    values_mm = np.where(steps == OUTSIDE, np.float32(np.nan), steps * np.float32(scale_mm))
    values_mm.setflags(write=False)
    if kind == SHEAR:
        return ShearMessage(*common, row0, col0, step_px, values_mm.reshape(rows, cols, 2))
    made = HeightMessage if kind == HEIGHT else SigmaMessage
    return made(*common, row0, col0, step_px, values_mm.reshape(rows, cols))


def _check(data: bytes) -> tuple[int, int, int]:
    """Check a payload's header, length and CRC; return its kind, rows and cols. Raises DecodeError."""
    if len(data) < HEADER_BYTES:
        raise DecodeError(
            f"height/cloud payload: found {len(data)} bytes, expected at least {HEADER_BYTES} (the header)"
        )
    magic, version, kind, codec = HEAD.unpack_from(data)[:4]
    for offset, name, found, expected in (
        (0, "magic", magic, (MAGIC,)),
        (4, "wire version", version, (WIRE_VERSION,)),
        (5, "kind", kind, (HEIGHT, CLOUD, SHEAR, SIGMA)),
        (6, "codec", codec, (RAW,)),
    ):
        if found not in expected:
            wanted = " or ".join(str(e) for e in expected)
            raise DecodeError(f"height/cloud payload, byte {offset}: found {name} {found}, expected {wanted}")
    rows, cols, said = *HEAD.unpack_from(data)[9:11], HEAD.unpack_from(data)[23]
    cells = rows | cols << 16 if kind == CLOUD else rows * cols
    if cells > CELLS_MAX:
        raise DecodeError(f"height/cloud payload, byte 32: found {cells} cells or points, expected at most {CELLS_MAX}")
    in_cloud = (_POINT_BYTES + _LABEL_BYTES) * (rows | cols << 16)
    needed = in_cloud if kind == CLOUD else 2 * rows * cols * _VALUES[kind]
    if said != needed:
        raise DecodeError(f"height/cloud payload, byte 84: found {said} payload bytes, expected {needed}")
    if len(data) != HEADER_BYTES + said:
        raise DecodeError(
            f"height/cloud payload: found {len(data)} bytes, expected {HEADER_BYTES + said}, as stated at byte 84"
        )
    crc, _ = CHECK.unpack_from(data, HEAD.size)
    actual = zlib.crc32(memoryview(data)[HEADER_BYTES:], zlib.crc32(data[: HEAD.size]))
    if crc != actual:
        raise DecodeError(f"height/cloud payload, byte 88: found CRC-32 {crc:08x}, expected {actual:08x}")
    return kind, rows, cols


def _check_grid(row0: float, col0: float, step_px: float, scale_mm: float) -> None:
    if not (abs(row0) <= _PX_MAX and abs(col0) <= _PX_MAX and _STEP_PX_LEAST <= step_px <= _PX_MAX):
        found = f"row0 {row0:g}, col0 {col0:g}, step_px {step_px:g}"
        raise DecodeError(
            f"height/cloud payload, byte 36: found {found}, expected a row, a column and a step within an image"
        )
    if not 0 < scale_mm <= 1:
        raise DecodeError(
            f"height/cloud payload, byte 48: found scale_mm {scale_mm:g}, expected a number above 0 and at most 1"
        )


def _check_pose(pose: tuple[float, ...]) -> None:
    *place, qw, qx, qy, qz = pose
    if not all(abs(mm) <= _MM_MAX for mm in place):
        raise DecodeError(
            "height/cloud payload, byte 56: found a position out of range, "
            f"expected a position within {_MM_MAX:g} mm of the origin"
        )
    if not abs((norm := math.hypot(qw, qx, qy, qz)) - 1) <= _UNIT_OFF_MAX:
        raise DecodeError(f"height/cloud payload, byte 68: found a quaternion of length {norm:.4g}, expected length 1")
