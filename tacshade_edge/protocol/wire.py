"""The binary MQTT payloads ``height``, ``cloud``, ``shear`` and ``sigma``: a 96-byte little-endian header, raw values.

The layout is the table of docs/mqtt.md, a promise to subscribers: it may only be added to. So a decoder
ignores flag bits and reserved bytes that it does not know, and refuses everything else that it does not know.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np

from tacshade_edge.errors import DecodeError
from tacshade_edge.types import F32, U16, HeightMap, Pose, Reconstruction

WIRE_VERSION: Final = 1
HEADER_BYTES: Final = 96
SCALE_MM: Final = 0.001
OUTSIDE: Final = -32768
CELLS_MAX: Final = 1 << 22
"""Of a grid that is decoded, and points of a cloud: a disc of 2048 px, each of its pixels a cell."""
PAYLOAD_BYTES_MAX: Final = 14 * CELLS_MAX
"""Of that many points, the largest kind."""
_LIMIT: Final = 32767
_PX_MAX, _MM_MAX = 1e5, 1e7
_STEP_PX_LEAST: Final = 1e-6
_UNIT_OFF_MAX: Final = 1e-2

_MAGIC: Final = b"TCSH"
_HEIGHT, _CLOUD, _SHEAR, _SIGMA = 1, 2, 3, 4
_RAW: Final = 0
_CONTACT, _INVALID, _SATURATED, _DEGRADED, _POSE = 1, 2, 4, 8, 16

# magic version kind codec flags | seq calibration t wall | rows cols | row0 col0 step scale | pose | payload bytes
_HEAD: Final = struct.Struct("<4s4B IIQQ 2H 4f I7f I")
_N: Final = struct.Struct("<I")
_CHECK: Final = struct.Struct("<II")
_U32: Final = 0xFFFFFFFF
_NO_POSE: Final = (0.0,) * 7
_POINT_BYTES, _LABEL_BYTES = 12, 2
_VALUES: Final = {_HEIGHT: 1, _SHEAR: 2, _SIGMA: 1}
"""Of a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class _Message:
    """What every kind carries.

    Attributes
    ----------
    seq : int
        Frame number modulo 2^32.
    calibration_crc32 : int
    t_ns, wall_ns : int
        Capture time: the sender's CLOCK_MONOTONIC, and Unix time.
    contact, invalid, saturated, degraded : bool
        As in `Reconstruction`; the reasons are in ``health`` and ``status/camera``.
    pose : Pose or None
        ``base_T_flange`` at `t_ns`.
    pose_error_us : int
        How far from `t_ns` the pose is known, in µs; 0 without a pose.
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
    """What those of values at each cell carry: cell (i, j) is image pixel (row0 + i·step_px, col0 + j·step_px)."""

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


def encode_height(
    result: Reconstruction, *, calibration_crc32: int, pose: Pose | None = None, pose_error_us: int = 0
) -> bytes:
    """The ``height`` payload of a reconstruction.

    A height is rounded to the nearest 0.001 mm and clamped to ±32.767 mm, infinities too; NaN becomes -32768.
    A grid of more than 65535 rows or columns has no encoding: ValueError.
    """
    height = result.height
    whose = _whose(result, calibration_crc32)
    return _pack(whose, _HEIGHT, *_steps(height.height_mm, height), pose, pose_error_us)


def encode_shear(
    result: Reconstruction, *, calibration_crc32: int, pose: Pose | None = None, pose_error_us: int = 0
) -> bytes:
    """The ``shear`` payload of a reconstruction with shear, coded as heights: x, y of each cell."""
    if result.shear_mm is None:
        raise ValueError(f"profile {result.profile} reports no shear")
    whose = _whose(result, calibration_crc32)
    return _pack(whose, _SHEAR, *_steps(result.shear_mm, result.height), pose, pose_error_us)


def encode_sigma(
    result: Reconstruction, *, calibration_crc32: int, pose: Pose | None = None, pose_error_us: int = 0
) -> bytes:
    """The ``sigma`` payload of a reconstruction with its errors, coded as heights."""
    if result.sigma_mm is None:
        raise ValueError(f"profile {result.profile} reports no error")
    whose = _whose(result, calibration_crc32)
    return _pack(whose, _SIGMA, *_steps(result.sigma_mm, result.height), pose, pose_error_us)


def encode_cloud(
    result: Reconstruction, *, calibration_crc32: int, pose: Pose | None = None, pose_error_us: int = 0
) -> bytes:
    """The ``cloud`` payload of a reconstruction; the grid fields of its header are 0."""
    points, labels = result.cloud.points_mm, result.cloud.labels
    payload = points.astype("<f4", copy=False).tobytes() + labels.astype("<u2", copy=False).tobytes()
    halves = struct.unpack("<2H", _N.pack(len(labels)))
    whose = _whose(result, calibration_crc32)
    return _pack(whose, _CLOUD, halves, (0.0, 0.0, 0.0), payload, pose, pose_error_us)


def encode_map_cloud(points_mm: F32, *, revision: int, calibration_crc32: int, t_ns: int, wall_ns: int) -> bytes:
    """The ``map/cloud`` payload: a ``cloud`` with points (N, 3) in the base frame; its sequence is the revision."""
    payload = points_mm.astype("<f4", copy=False).tobytes() + np.ones(len(points_mm), "<u2").tobytes()
    halves = struct.unpack("<2H", _N.pack(len(points_mm)))
    whose = (_CONTACT, revision, calibration_crc32, t_ns, wall_ns)
    return _pack(whose, _CLOUD, halves, (0.0, 0.0, 0.0), payload, None, 0)


def decode(data: bytes | bytearray | memoryview) -> HeightMessage | CloudMessage | ShearMessage | SigmaMessage:
    """Understand one ``height``, ``cloud``, ``shear`` or ``sigma`` payload; the result owns its arrays.

    Raises
    ------
    DecodeError
        Too short, another magic, version, kind or codec, a length that does not fit, a wrong CRC, more than `CELLS_MAX`
        cells or points, or a number that no sensor, robot or object has.
    """
    data = bytes(data)
    kind, rows, cols = _check(data)
    fields = _HEAD.unpack_from(data)
    flags, seq, calibration, t_ns, wall_ns = fields[4:9]
    row0, col0, step_px, scale_mm, error_us = fields[11:16]
    if kind != _CLOUD:
        _check_grid(row0, col0, step_px, scale_mm)
    if flags & _POSE:
        _check_pose(fields[16:23])
    common = (
        seq,
        calibration,
        t_ns,
        wall_ns,
        bool(flags & _CONTACT),
        bool(flags & _INVALID),
        bool(flags & _SATURATED),
        bool(flags & _DEGRADED),
        Pose(t_ns, *fields[16:23]) if flags & _POSE else None,
        error_us if flags & _POSE else 0,
    )
    if kind == _CLOUD:
        n = rows | cols << 16
        points = np.frombuffer(data, "<f4", 3 * n, HEADER_BYTES).astype(np.float32, copy=False)
        if not (np.abs(points) <= _MM_MAX).all():  # nor is it NaN
            raise DecodeError(f"height/cloud payload: found a point that is not within {_MM_MAX:g} mm")
        labels = np.frombuffer(data, "<u2", n, HEADER_BYTES + _POINT_BYTES * n).astype(np.uint16, copy=False)
        return CloudMessage(*common, points.reshape(n, 3), labels)
    steps = np.frombuffer(data, "<i2", rows * cols * _VALUES[kind], HEADER_BYTES)
    values_mm = np.where(steps == OUTSIDE, np.float32(np.nan), steps * np.float32(scale_mm))
    values_mm.setflags(write=False)
    if kind == _SHEAR:
        return ShearMessage(*common, row0, col0, step_px, values_mm.reshape(rows, cols, 2))
    made = HeightMessage if kind == _HEIGHT else SigmaMessage
    return made(*common, row0, col0, step_px, values_mm.reshape(rows, cols))


def _check(data: bytes) -> tuple[int, int, int]:
    """Kind, rows and cols of a payload whose frame is sound; Raises DecodeError."""
    if len(data) < HEADER_BYTES:
        raise DecodeError(f"height/cloud payload: {len(data)} bytes, expected at least {HEADER_BYTES} (the header)")
    magic, version, kind, codec = _HEAD.unpack_from(data)[:4]
    for offset, name, found, expected in (
        (0, "magic", magic, (_MAGIC,)),
        (4, "wire version", version, (WIRE_VERSION,)),
        (5, "kind", kind, (_HEIGHT, _CLOUD, _SHEAR, _SIGMA)),
        (6, "codec", codec, (_RAW,)),
    ):
        if found not in expected:
            wanted = " or ".join(str(e) for e in expected)
            raise DecodeError(f"height/cloud payload, byte {offset}: {name} is {found}, expected {wanted}")
    rows, cols, said = *_HEAD.unpack_from(data)[9:11], _HEAD.unpack_from(data)[23]
    cells = rows | cols << 16 if kind == _CLOUD else rows * cols
    if cells > CELLS_MAX:
        raise DecodeError(f"height/cloud payload, byte 32: {cells} cells or points, expected at most {CELLS_MAX}")
    in_cloud = (_POINT_BYTES + _LABEL_BYTES) * (rows | cols << 16)
    needed = in_cloud if kind == _CLOUD else 2 * rows * cols * _VALUES[kind]
    if said != needed:
        raise DecodeError(f"height/cloud payload, byte 84: {said} payload bytes, expected {needed} for this size")
    if len(data) != HEADER_BYTES + said:
        raise DecodeError(f"height/cloud payload: {len(data)} bytes, expected {HEADER_BYTES + said} as byte 84 says")
    crc, _ = _CHECK.unpack_from(data, _HEAD.size)
    actual = zlib.crc32(memoryview(data)[HEADER_BYTES:], zlib.crc32(data[: _HEAD.size]))
    if crc != actual:
        raise DecodeError(f"height/cloud payload, byte 88: CRC-32 {crc:08x}, expected {actual:08x}")
    return kind, rows, cols


def _check_grid(row0: float, col0: float, step_px: float, scale_mm: float) -> None:
    if not (abs(row0) <= _PX_MAX and abs(col0) <= _PX_MAX and _STEP_PX_LEAST <= step_px <= _PX_MAX):
        found = f"row0 {row0:g}, col0 {col0:g}, step_px {step_px:g}"
        raise DecodeError(f"height/cloud payload, byte 36: {found}, expected pixels of an image")
    if not 0 < scale_mm <= 1:
        raise DecodeError(f"height/cloud payload, byte 48: scale_mm is {scale_mm:g}, expected above 0 and at most 1")


def _check_pose(pose: tuple[float, ...]) -> None:
    *place, qw, qx, qy, qz = pose
    if not all(abs(mm) <= _MM_MAX for mm in place):
        raise DecodeError(f"height/cloud payload, byte 56: found a place that is not within {_MM_MAX:g} mm")
    if not abs(math.hypot(qw, qx, qy, qz) - 1) <= _UNIT_OFF_MAX:
        raise DecodeError("height/cloud payload, byte 68: found no unit quaternion")


def _steps(values_mm: F32, height: HeightMap) -> tuple[tuple[int, ...], tuple[float, float, float], bytes]:
    """Size, grid and int16 steps of values at each cell of a map."""
    rows, cols = values_mm.shape[:2]
    if max(rows, cols) > 0xFFFF:
        raise ValueError(f"height grid of {rows} x {cols}; the wire holds at most 65535 x 65535")
    limit_mm = np.float32(_LIMIT * SCALE_MM)
    steps = np.clip(values_mm, -limit_mm, limit_mm)  # before the product, which could overflow
    np.multiply(steps, np.float32(1.0 / SCALE_MM), out=steps)
    np.rint(steps, out=steps)
    np.fmax(steps, np.float32(OUTSIDE), out=steps)  # it takes the number where the other is NaN
    return (rows, cols), (height.row0, height.col0, height.step_px), steps.astype("<i2").tobytes()


def _whose(result: Reconstruction, calibration_crc32: int) -> tuple[int, int, int, int, int]:
    """Flags, sequence, calibration and times of a reconstruction."""
    flags = (
        _CONTACT * result.contact
        | _INVALID * (not result.valid)
        | _SATURATED * result.saturated
        | _DEGRADED * (result.degraded is not None)
    )
    return flags, result.seq, calibration_crc32, result.t_ns, result.wall_ns


def _pack(
    whose: tuple[int, int, int, int, int],
    kind: int,
    size: tuple[int, ...],
    grid: tuple[float, float, float],
    payload: bytes,
    pose: Pose | None,
    pose_error_us: int,
) -> bytes:
    flags, seq, calibration_crc32, t_ns, wall_ns = whose
    head = _HEAD.pack(
        *(_MAGIC, WIRE_VERSION, kind, _RAW, flags | _POSE * (pose is not None)),
        *(seq & _U32, calibration_crc32 & _U32, t_ns, wall_ns),
        *size,
        *grid,
        SCALE_MM,
        0 if pose is None else min(pose_error_us, _U32),
        *(_NO_POSE if pose is None else (pose.x_mm, pose.y_mm, pose.z_mm, pose.qw, pose.qx, pose.qy, pose.qz)),
        len(payload),
    )
    return head + _CHECK.pack(zlib.crc32(payload, zlib.crc32(head)), 0) + payload
