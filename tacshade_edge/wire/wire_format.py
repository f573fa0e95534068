"""The binary payloads ``height``, ``cloud``, ``shear`` and ``sigma``:
a 96-byte little-endian header and data.

docs/reference/mqtt/frames.md defines the layout, a promise to subscribers: it may only grow.
Therefore the decoder ignores unknown flag bits and reserved bytes and rejects everything else
unknown.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Any, Final, NoReturn

import numpy as np

from ..errors import DecodeError
from ..types.geometry import F32, U16, Pose

WIRE_VERSION: Final = 1
HEADER_BYTES: Final = 96
# The one value of an int16 that no height needs: its mirror image, +32768, does not exist.
OUTSIDE: Final = -32768
CELLS_MAX: Final = 1 << 22
"""Most cells of a decoded grid, or points of a cloud:
a disc of 2048 px with a cell for each pixel.
"""
PAYLOAD_BYTES_MAX: Final = 14 * CELLS_MAX
"""Size of the largest payload, a cloud of `CELLS_MAX` points."""
# Wider than any sensor or robot, so that only damage and nonsense exceed them.
_PX_MAX, _MM_MAX = 1e5, 1e7
_STEP_PX_LEAST: Final = 1e-6
# Robots round their quaternions, and the header holds float32; whatever is further off is damaged
# or something else.
_UNIT_OFF_MAX: Final = 1e-2
# 1 µm: finer than any sensor's noise, and ±32.767 mm is deeper than any skin of a hand.
SCALE_MM: Final = 0.001
SCALE_MAX_MM: Final = 1.0
STEPS_MAX: Final = 32767
SIDE_MAX: Final = 0xFFFF
_U32: Final = 0xFFFFFFFF

_MAGIC: Final = b"TCSH"
_RAW: Final = 0
_FLAGS: Final = {"contact": 1, "invalid": 2, "saturated": 4, "degraded": 8, "touched": 32}
# Apart from the other flags, since it states that other bytes count.
_POSE: Final = 16
_NO_POSE: Final = (0.0,) * 7

# magic version kind codec flags | seq calibration t wall | rows cols | row0 col0 step scale |
# pose | payload bytes
# "<" is little-endian and without padding: the offsets are promised to other languages.
HEAD: Final = struct.Struct("<4s4B IIQQ 2H 4f I7f I")
# Payloads are also kept in files, where nothing else finds a flipped bit. Then 4 reserved bytes.
_CHECK: Final = struct.Struct("<II")
_POINT_BYTES, _LABEL_BYTES = 12, 2


@dataclass(frozen=True, slots=True, eq=False)
class Header:
    """The fields of every kind of message.

    `seq` is the frame number modulo 2^32; `t_ns` and `wall_ns` are the capture time, on the
    sender's CLOCK_MONOTONIC and in Unix time. The reasons of the flags are in ``health`` and
    ``status/camera``. `pose` is ``base_T_flange`` at `t_ns`, and `pose_error_us` the uncertainty of
    its time, 0 without a pose. `touched`: something touches, but its depth is unknown; `contact` is
    then False.
    """

    seq: int
    calibration_crc32: int
    t_ns: int
    wall_ns: int
    contact: bool
    invalid: bool
    saturated: bool
    degraded: bool
    touched: bool
    pose: Pose | None
    pose_error_us: int


@dataclass(frozen=True, slots=True, eq=False)
class _GridMessage(Header):
    """The grid of the kinds with a value per cell:
    cell (i, j) is image pixel (row0 + i·step_px, col0 + j·step_px).
    """

    row0: float
    col0: float
    step_px: float


@dataclass(frozen=True, slots=True, eq=False)
class HeightMessage(_GridMessage):
    """A decoded ``height``: `height_mm`, read-only float32 (rows, cols), is the radial deformation,
    positive inwards, in steps of the scale; NaN outside the disc.
    """

    height_mm: F32


@dataclass(frozen=True, slots=True, eq=False)
class CloudMessage(Header):
    """A decoded ``cloud``: `points_mm`, read-only float32 (N, 3), are x, y, z in the sensor frame;
    `labels`, read-only uint16 (N,), are the object number of each point, from 1.
    """

    points_mm: F32
    labels: U16


@dataclass(frozen=True, slots=True, eq=False)
class ShearMessage(_GridMessage):
    """A decoded ``shear``: `shear_mm`, read-only float32 (rows, cols, 2), is the shear of the skin
    along x and y, in steps of the scale; NaN outside the disc.
    """

    shear_mm: F32


@dataclass(frozen=True, slots=True, eq=False)
class SigmaMessage(_GridMessage):
    """A decoded ``sigma``: `sigma_mm`, read-only float32 (rows, cols), is the standard deviation of
    the height, in steps of the scale; NaN where nothing touches.
    """

    sigma_mm: F32


Message = HeightMessage | CloudMessage | ShearMessage | SigmaMessage
HEIGHT: Final = 1
CLOUD: Final = 2
SHEAR: Final = 3
SIGMA: Final = 4
GRIDS: Final[dict[int, tuple[str, type[HeightMessage | ShearMessage | SigmaMessage], int]]] = {
    HEIGHT: ("height", HeightMessage, 1),
    SHEAR: ("shear", ShearMessage, 2),
    SIGMA: ("sigma", SigmaMessage, 1),
}
"""The kinds with values in each cell: the topic, with ``_mm`` the name of the message's array; the
message; and the number of values in a cell.
"""


def pack(
    kind: int,
    shape: tuple[int, int],
    grid: tuple[float, float, float, float],
    data: bytes,
    fields: Header,
) -> bytes:
    """The payload of a kind with these rows and columns, row0, col0 and step_px (0 for a cloud) and
    scale_mm, data, and the fields of every kind.

    `seq`, `calibration_crc32` and `pose_error_us` need not fit in 32 bits.
    """
    # By name and not by order: bit 16 lies between the flags of `_FLAGS`.
    flags = 0
    for name, bit in _FLAGS.items():
        if getattr(fields, name):
            flags |= bit
    if fields.pose is None:
        error_us, pose = 0, _NO_POSE
    else:
        flags |= _POSE
        error_us, pose = min(fields.pose_error_us, _U32), _seven(fields.pose)
    head = HEAD.pack(
        _MAGIC,
        WIRE_VERSION,
        kind,
        _RAW,
        flags,
        fields.seq & _U32,
        fields.calibration_crc32 & _U32,
        fields.t_ns,
        fields.wall_ns,
        *shape,
        *grid,
        error_us,
        *pose,
        len(data),
    )
    # One join, since each `+` would copy the data again; and the CRC goes on from the header's, so
    # that nothing is joined for it.
    return b"".join((head, _CHECK.pack(zlib.crc32(data, zlib.crc32(head)), 0), data))


def _seven(pose: Pose) -> tuple[float, float, float, float, float, float, float]:
    return pose.x_mm, pose.y_mm, pose.z_mm, pose.qw, pose.qx, pose.qy, pose.qz


def decode(data: bytes | bytearray | memoryview) -> Message:
    """Decode one ``height``, ``cloud``, ``shear`` or ``sigma`` payload; the result owns its arrays.

    Raises DecodeError if the payload is too short, has an unknown magic, version, kind or codec, a
    wrong length or CRC, more than `CELLS_MAX` cells or points, or a number that no sensor, robot or
    object has.
    """
    # A copy unless it is bytes already: the arrays look into it, and a caller reuses its buffer.
    data = bytes(data)
    kind, rows, cols = _check(data)
    fields = HEAD.unpack_from(data)
    flags, seq, calibration, t_ns, wall_ns = fields[4:9]
    row0, col0, step_px, scale_mm, error_us = fields[11:16]
    if kind != CLOUD:
        _check_grid(rows, cols, row0, col0, step_px, scale_mm)
    pose = None
    if flags & _POSE:
        _check_pose(fields[16:23])
        pose = Pose(t_ns, *fields[16:23])
    common: dict[str, Any] = {name: bool(flags & bit) for name, bit in _FLAGS.items()}
    common |= {
        "seq": seq,
        "calibration_crc32": calibration,
        "t_ns": t_ns,
        "wall_ns": wall_ns,
        "pose": pose,
        "pose_error_us": error_us if pose else 0,
    }
    if kind == CLOUD:
        # A cloud has no grid, so rows and columns are the halves of its number of points.
        n = rows | cols << 16
        points = np.frombuffer(data, "<f4", 3 * n, HEADER_BYTES).astype(np.float32, copy=False)
        # Asked this way round, so that NaN is rejected too.
        if not (np.abs(points) <= _MM_MAX).all():
            _refuse("", "a point out of range", f"every point within {_MM_MAX:g} mm of the origin")
        labels = np.frombuffer(data, "<u2", n, HEADER_BYTES + _POINT_BYTES * n).astype(
            np.uint16, copy=False
        )
        return CloudMessage(**common, points_mm=points.reshape(n, 3), labels=labels)
    topic, made, per_cell = GRIDS[kind]
    steps = np.frombuffer(data, "<i2", rows * cols * per_cell, HEADER_BYTES)
    # Scalars of float32: with a Python float the product would be float64, twice the memory.
    values_mm = np.where(steps == OUTSIDE, np.float32(np.nan), steps * np.float32(scale_mm))
    values_mm.setflags(write=False)
    common[f"{topic}_mm"] = values_mm.reshape((rows, cols, per_cell)[: 1 + per_cell])
    return made(**common, row0=row0, col0=col0, step_px=step_px)


def _refuse(byte: str, found: str, expected: str) -> NoReturn:
    raise DecodeError(
        f"height/cloud payload{byte and f', byte {byte}'}: found {found}, expected {expected}"
    )


def _check(data: bytes) -> tuple[int, int, int]:
    """Check a payload's header, length and CRC; return its kind, rows and cols.

    Raises DecodeError.
    """
    if len(data) < HEADER_BYTES:
        _refuse("", f"{len(data)} bytes", f"at least {HEADER_BYTES} (the header)")
    magic, version, kind, codec, _, _, _, _, _, rows, cols, *_, stated = HEAD.unpack_from(data)
    # The magic first: whoever sends something else should read that, and not of a length.
    for offset, name, found, expected in (
        ("0", "magic", magic, (_MAGIC,)),
        ("4", "wire version", version, (WIRE_VERSION,)),
        ("5", "kind", kind, sorted((CLOUD, *GRIDS))),
        ("6", "codec", codec, (_RAW,)),
    ):
        if found not in expected:
            _refuse(offset, f"{name} {found}", " or ".join(map(str, expected)))
    cells = rows | cols << 16 if kind == CLOUD else rows * cols
    # Before anything of that size is computed or allocated: the header may be a stranger's.
    if cells > CELLS_MAX:
        _refuse("32", f"{cells} cells or points", f"at most {CELLS_MAX}")
    needed = cells * (_POINT_BYTES + _LABEL_BYTES if kind == CLOUD else 2 * GRIDS[kind][2])
    if stated != needed:
        _refuse("84", f"{stated} payload bytes", f"{needed}")
    if len(data) != HEADER_BYTES + stated:
        _refuse("", f"{len(data)} bytes", f"{HEADER_BYTES + stated}, as stated at byte 84")
    # Last, because it reads all bytes.
    crc, _ = _CHECK.unpack_from(data, HEAD.size)
    actual = zlib.crc32(memoryview(data)[HEADER_BYTES:], zlib.crc32(data[: HEAD.size]))
    if crc != actual:
        _refuse("88", f"CRC-32 {crc:08x}", f"{actual:08x}")
    return kind, rows, cols


def _check_grid(
    rows: int, cols: int, row0: float, col0: float, step_px: float, scale_mm: float
) -> None:
    if not rows * cols:
        _refuse("32", f"{rows} x {cols} cells", "at least one")
    # A comparison with NaN is false, so each states what is right.
    if not (abs(row0) <= _PX_MAX and abs(col0) <= _PX_MAX and _STEP_PX_LEAST <= step_px <= _PX_MAX):
        found = f"row0 {row0:g}, col0 {col0:g}, step_px {step_px:g}"
        _refuse("36", found, "a row, a column and a step within an image")
    if not 0 < scale_mm <= SCALE_MAX_MM:
        _refuse("48", f"scale_mm {scale_mm:g}", "a number above 0 and at most 1")


def _check_pose(pose: tuple[float, ...]) -> None:
    *place, qw, qx, qy, qz = pose
    if not all(abs(mm) <= _MM_MAX for mm in place):
        _refuse("56", "a position out of range", f"a position within {_MM_MAX:g} mm of the origin")
    if not abs((norm := math.hypot(qw, qx, qy, qz)) - 1) <= _UNIT_OFF_MAX:
        _refuse("68", f"a quaternion of length {norm:.4g}", "length 1")
