"""Encode a reconstruction's `height`, `cloud`, `shear` and `sigma`; `wire_format` has the layout."""

from __future__ import annotations

from typing import Any, Required, TypedDict, Unpack

import numpy as np

from tacshade_edge.protocol import wire_format
from tacshade_edge.protocol.wire_format import CloudMessage, HeightMessage, ShearMessage, SigmaMessage, encode
from tacshade_edge.types import F32, Pose, Reconstruction

__all__ = ["CloudMessage", "HeightMessage", "ShearMessage", "SigmaMessage", "decode"]

HEAD, HEADER_BYTES, PAYLOAD_BYTES_MAX = wire_format.HEAD, wire_format.HEADER_BYTES, wire_format.PAYLOAD_BYTES_MAX
decode = wire_format.decode


class _Taken(TypedDict, total=False):
    """What else the header states of a frame: its calibration, and the robot's pose with the error of its time."""

    calibration_crc32: Required[int]
    pose: Pose | None
    pose_error_us: int


def encode_height(result: Reconstruction, **taken: Unpack[_Taken]) -> bytes:
    """The ``height`` payload of a reconstruction. Raises ValueError as `wire_format.encode` does."""
    return encode(HeightMessage(**_frame(result, taken), **_grid(result), height_mm=result.height.height_mm))


def encode_shear(result: Reconstruction, **taken: Unpack[_Taken]) -> bytes:
    """The ``shear`` payload of a reconstruction with shear: x, y of each cell, encoded like heights."""
    assert result.shear_mm is not None
    return encode(ShearMessage(**_frame(result, taken), **_grid(result), shear_mm=result.shear_mm))


def encode_sigma(result: Reconstruction, **taken: Unpack[_Taken]) -> bytes:
    """The ``sigma`` payload of a reconstruction with sigma, encoded like heights."""
    assert result.sigma_mm is not None
    return encode(SigmaMessage(**_frame(result, taken), **_grid(result), sigma_mm=result.sigma_mm))


def encode_cloud(result: Reconstruction, **taken: Unpack[_Taken]) -> bytes:
    """The ``cloud`` payload of a reconstruction; the grid fields of its header are 0."""
    cloud = result.cloud
    return encode(CloudMessage(**_frame(result, taken), points_mm=cloud.points_mm, labels=cloud.labels))


def encode_map_cloud(points_mm: F32, *, revision: int, calibration_crc32: int, t_ns: int, wall_ns: int) -> bytes:
    """The ``map/cloud`` payload: a ``cloud`` of points (N, 3) in the base frame, with the revision as its sequence."""
    fields: dict[str, Any] = {"contact": True, "invalid": False, "saturated": False, "degraded": False}
    fields |= {"seq": revision, "calibration_crc32": calibration_crc32, "t_ns": t_ns, "wall_ns": wall_ns}
    labels = np.ones(len(points_mm), np.uint16)
    return encode(CloudMessage(**fields, pose=None, pose_error_us=0, points_mm=points_mm, labels=labels))


def _frame(result: Reconstruction, taken: _Taken) -> dict[str, Any]:
    """The fields of every kind."""
    flags = {"contact": result.contact, "invalid": not result.valid, "saturated": result.saturated}
    times = {"seq": result.seq, "t_ns": result.t_ns, "wall_ns": result.wall_ns}
    return {**times, **flags, "degraded": result.degraded is not None, "pose": None, "pose_error_us": 0, **taken}


def _grid(result: Reconstruction) -> dict[str, Any]:
    return {"row0": result.height.row0, "col0": result.height.col0, "step_px": result.height.step_px}
