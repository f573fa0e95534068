"""Encode `height`, `cloud`, `shear` and `sigma`; `wire_decoder`, which subscribers use too, decodes them."""

from __future__ import annotations

import struct
import zlib
from typing import Final

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
from tacshade_edge.types import F32, HeightMap, Pose, Reconstruction

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


def encode_height(
    result: Reconstruction, *, calibration_crc32: int, pose: Pose | None = None, pose_error_us: int = 0
) -> bytes:
    """The ``height`` payload of a reconstruction.

    Heights are rounded to the nearest 0.001 mm and clamped to ±32.767 mm, infinities too; NaN becomes -32768.
    Raises ValueError for a grid of more than 65535 rows or columns.
    """
    height = result.height
    whose = _whose(result, calibration_crc32)
    return _pack(whose, HEIGHT, *_steps(height.height_mm, height), pose, pose_error_us)


def encode_shear(
    result: Reconstruction, *, calibration_crc32: int, pose: Pose | None = None, pose_error_us: int = 0
) -> bytes:
    """The ``shear`` payload of a reconstruction with shear: x, y of each cell, encoded like heights."""
    if result.shear_mm is None:
        raise ValueError(f"profile {result.profile} reports no shear")
    whose = _whose(result, calibration_crc32)
    return _pack(whose, SHEAR, *_steps(result.shear_mm, result.height), pose, pose_error_us)


def encode_sigma(
    result: Reconstruction, *, calibration_crc32: int, pose: Pose | None = None, pose_error_us: int = 0
) -> bytes:
    """The ``sigma`` payload of a reconstruction with sigma, encoded like heights."""
    if result.sigma_mm is None:
        raise ValueError(f"profile {result.profile} reports no error")
    whose = _whose(result, calibration_crc32)
    return _pack(whose, SIGMA, *_steps(result.sigma_mm, result.height), pose, pose_error_us)


def encode_cloud(
    result: Reconstruction, *, calibration_crc32: int, pose: Pose | None = None, pose_error_us: int = 0
) -> bytes:
    """The ``cloud`` payload of a reconstruction; the grid fields of its header are 0."""
    points, labels = result.cloud.points_mm, result.cloud.labels
    payload = points.astype("<f4", copy=False).tobytes() + labels.astype("<u2", copy=False).tobytes()
    halves = struct.unpack("<2H", COUNT.pack(len(labels)))
    whose = _whose(result, calibration_crc32)
    return _pack(whose, CLOUD, halves, (0.0, 0.0, 0.0), payload, pose, pose_error_us)


def encode_map_cloud(points_mm: F32, *, revision: int, calibration_crc32: int, t_ns: int, wall_ns: int) -> bytes:
    """The ``map/cloud`` payload: a ``cloud`` of points (N, 3) in the base frame, with the revision as its sequence."""
    payload = points_mm.astype("<f4", copy=False).tobytes() + np.ones(len(points_mm), "<u2").tobytes()
    halves = struct.unpack("<2H", COUNT.pack(len(points_mm)))
    whose = (CONTACT, revision, calibration_crc32, t_ns, wall_ns)
    return _pack(whose, CLOUD, halves, (0.0, 0.0, 0.0), payload, None, 0)


def _steps(values_mm: F32, height: HeightMap) -> tuple[tuple[int, ...], tuple[float, float, float], bytes]:
    """Size, grid and int16 steps of a map's values."""
    rows, cols = values_mm.shape[:2]
    if max(rows, cols) > 0xFFFF:
        raise ValueError(f"height grid of {rows} x {cols}; the wire holds at most 65535 x 65535")
    limit_mm = np.float32(_LIMIT * SCALE_MM)
    steps = np.clip(values_mm, -limit_mm, limit_mm)  # before the multiplication, which could overflow
    np.multiply(steps, np.float32(1.0 / SCALE_MM), out=steps)
    np.rint(steps, out=steps)
    np.fmax(steps, np.float32(OUTSIDE), out=steps)  # fmax replaces NaN
    return (rows, cols), (height.row0, height.col0, height.step_px), steps.astype("<i2").tobytes()


def _whose(result: Reconstruction, calibration_crc32: int) -> tuple[int, int, int, int, int]:
    """Flags, sequence, calibration and times of a reconstruction."""
    flags = (
        CONTACT * result.contact
        | INVALID * (not result.valid)
        | SATURATED * result.saturated
        | DEGRADED * (result.degraded is not None)
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
