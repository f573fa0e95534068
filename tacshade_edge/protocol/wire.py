"""Encode `height`, `cloud`, `shear` and `sigma`; `wire_decoder`, which subscribers use too, has the layout."""

from __future__ import annotations

import struct
import zlib
from typing import Final, Required, TypedDict, Unpack

import numpy as np

from tacshade_edge.protocol.wire_decoder import (
    CELLS_MAX,
    CHECK,
    CLOUD,
    CONTACT,
    COUNT,
    DEGRADED,
    HEAD,
    HEADER_BYTES,
    HEIGHT,
    INVALID,
    MAGIC,
    OUTSIDE,
    PAYLOAD_BYTES_MAX,
    POSE,
    RAW,
    SATURATED,
    SHEAR,
    SIGMA,
    WIRE_VERSION,
    CloudMessage,
    HeightMessage,
    ShearMessage,
    SigmaMessage,
    decode,
)
from tacshade_edge.types import F32, Pose, Reconstruction

__all__ = [
    "CELLS_MAX",
    "HEADER_BYTES",
    "OUTSIDE",
    "PAYLOAD_BYTES_MAX",
    "WIRE_VERSION",
    "CloudMessage",
    "HeightMessage",
    "ShearMessage",
    "SigmaMessage",
    "decode",
    "encode_cloud",
    "encode_height",
    "encode_map_cloud",
    "encode_shear",
    "encode_sigma",
]

SCALE_MM: Final = 0.001
_LIMIT: Final = 32767
_U32: Final = 0xFFFFFFFF
_NO_POSE: Final = (0.0,) * 7
_NO_GRID: Final = (0.0, 0.0, 0.0)


class _Taken(TypedDict, total=False):
    """What else the header tells of a frame: its calibration, and the robot's pose with the error of its time."""

    calibration_crc32: Required[int]
    pose: Pose | None
    pose_error_us: int


def encode_height(result: Reconstruction, **taken: Unpack[_Taken]) -> bytes:
    """The ``height`` payload of a reconstruction.

    Heights are rounded to the nearest 0.001 mm and clamped to ±32.767 mm, infinities too; NaN becomes -32768.
    Raises ValueError for a grid of more than 65535 rows or columns.
    """
    return _encode_grid(HEIGHT, result.height.height_mm, result, **taken)


def encode_shear(result: Reconstruction, **taken: Unpack[_Taken]) -> bytes:
    """The ``shear`` payload of a reconstruction with shear: x, y of each cell, encoded like heights."""
    if result.shear_mm is None:
        raise ValueError(f"profile {result.profile} reports no shear")
    return _encode_grid(SHEAR, result.shear_mm, result, **taken)


def encode_sigma(result: Reconstruction, **taken: Unpack[_Taken]) -> bytes:
    """The ``sigma`` payload of a reconstruction with sigma, encoded like heights."""
    if result.sigma_mm is None:
        raise ValueError(f"profile {result.profile} reports no error")
    return _encode_grid(SIGMA, result.sigma_mm, result, **taken)


def encode_cloud(result: Reconstruction, **taken: Unpack[_Taken]) -> bytes:
    """The ``cloud`` payload of a reconstruction; the grid fields of its header are 0."""
    labels = result.cloud.labels
    payload = result.cloud.points_mm.astype("<f4", copy=False).tobytes() + labels.astype("<u2", copy=False).tobytes()
    return _pack(CLOUD, _halves(len(labels)), _NO_GRID, payload, *_frame(result), **taken)


def encode_map_cloud(points_mm: F32, *, revision: int, calibration_crc32: int, t_ns: int, wall_ns: int) -> bytes:
    """The ``map/cloud`` payload: a ``cloud`` of points (N, 3) in the base frame, with the revision as its sequence."""
    payload = points_mm.astype("<f4", copy=False).tobytes() + np.ones(len(points_mm), "<u2").tobytes()
    when = (CONTACT, revision, t_ns, wall_ns)
    return _pack(CLOUD, _halves(len(points_mm)), _NO_GRID, payload, *when, calibration_crc32=calibration_crc32)


def _halves(count: int) -> tuple[int, ...]:
    """The number of points, in the place of rows and columns."""
    return struct.unpack("<2H", COUNT.pack(count))


def _encode_grid(kind: int, values_mm: F32, result: Reconstruction, **taken: Unpack[_Taken]) -> bytes:
    rows, cols = values_mm.shape[:2]
    if max(rows, cols) > 0xFFFF:
        raise ValueError(f"height grid of {rows} x {cols}; the wire holds at most 65535 x 65535")
    limit_mm = np.float32(_LIMIT * SCALE_MM)
    steps = np.clip(values_mm, -limit_mm, limit_mm)  # before the multiplication, which could overflow
    np.multiply(steps, np.float32(1.0 / SCALE_MM), out=steps)
    np.rint(steps, out=steps)
    np.fmax(steps, np.float32(OUTSIDE), out=steps)  # fmax replaces NaN
    grid = (result.height.row0, result.height.col0, result.height.step_px)
    return _pack(kind, (rows, cols), grid, steps.astype("<i2").tobytes(), *_frame(result), **taken)


def _frame(result: Reconstruction) -> tuple[int, int, int, int]:
    """Flags, sequence and times."""
    flags = (
        CONTACT * result.contact
        | INVALID * (not result.valid)
        | SATURATED * result.saturated
        | DEGRADED * (result.degraded is not None)
    )
    return flags, result.seq, result.t_ns, result.wall_ns


def _pack(
    kind: int,
    size: tuple[int, ...],
    grid: tuple[float, float, float],
    payload: bytes,
    flags: int,
    seq: int,
    t_ns: int,
    wall_ns: int,
    *,
    calibration_crc32: int,
    pose: Pose | None = None,
    pose_error_us: int = 0,
) -> bytes:
    head = HEAD.pack(
        *(MAGIC, WIRE_VERSION, kind, RAW, flags | POSE * (pose is not None)),
        *(seq & _U32, calibration_crc32 & _U32, t_ns, wall_ns),
        *size,
        *grid,
        SCALE_MM,
        0 if pose is None else min(pose_error_us, _U32),
        *(_NO_POSE if pose is None else (pose.x_mm, pose.y_mm, pose.z_mm, pose.qw, pose.qx, pose.qy, pose.qz)),
        len(payload),
    )
    return head + CHECK.pack(zlib.crc32(payload, zlib.crc32(head)), 0) + payload
