"""Encode a reconstruction's `height`, `cloud`, `shear` and `sigma`;
`wire_format` has the layout.
"""

from __future__ import annotations

import math
from typing import Required, TypedDict, Unpack

import numpy as np

from tacshade_edge.types import F32, U16, Pose, Reconstruction
from tacshade_edge.wire import wire_format
from tacshade_edge.wire.wire_format import (
    CloudMessage,
    Header,
    HeightMessage,
    ShearMessage,
    SigmaMessage,
    pack,
)

__all__ = ["CloudMessage", "HeightMessage", "ShearMessage", "SigmaMessage", "decode"]

HEAD = wire_format.HEAD
HEADER_BYTES = wire_format.HEADER_BYTES
PAYLOAD_BYTES_MAX = wire_format.PAYLOAD_BYTES_MAX
decode = wire_format.decode
_LIMIT_MM = wire_format.STEPS_MAX * wire_format.SCALE_MM
_OUTSIDE = np.float32(wire_format.OUTSIDE)
_NO_GRID = (0.0, 0.0, 0.0, wire_format.SCALE_MM)


class Taken(TypedDict, total=False):
    """What else the header states of a frame: its calibration,
    and the robot's pose with the error of its time.
    """

    calibration_crc32: Required[int]
    pose: Pose | None
    pose_error_us: int


def encode_grid(kind: int, result: Reconstruction, values_mm: F32, **taken: Unpack[Taken]) -> bytes:
    """The payload of one of `wire_format.GRIDS`: the values of each cell of a reconstruction,
    (rows, cols) or (rows, cols, values), rounded to the nearest multiple of `scale_of` them and
    clamped to ±32767 of it, infinities too; NaN becomes -32768.

    Raises ValueError for a grid of more than 65535 rows or columns.
    """
    rows, cols = values_mm.shape[:2]
    if max(rows, cols) > wire_format.SIDE_MAX:
        raise ValueError(f"height grid of {rows} x {cols}; the wire holds at most 65535 x 65535")
    scale_mm = scale_of(values_mm)
    most_mm = np.float32(wire_format.STEPS_MAX * scale_mm)
    # Before the multiplication, which could overflow.
    steps = values_mm.clip(-most_mm, most_mm)
    # In one array, since this happens to each frame of each sensor.
    np.multiply(steps, np.float32(1 / scale_mm), out=steps)
    np.rint(steps, out=steps)
    # fmax replaces NaN, maximum would keep it.
    np.fmax(steps, _OUTSIDE, out=steps)
    height = result.height
    grid = height.row0, height.col0, height.step_px, scale_mm
    return _pack(kind, result, taken, (rows, cols), grid, steps.astype("<i2").tobytes())


def scale_of(values_mm: F32) -> float:
    """The `scale_mm` of values: 0.001, or its least multiple by which the greatest value fits, as
    on skins deeper than 32.767 mm. What fits by none is no depth.
    """
    # fmax and fmin pass over NaN.
    high, low = (each.reduce(values_mm, axis=None, initial=0.0) for each in (np.fmax, np.fmin))
    times = max(float(high), -float(low)) / _LIMIT_MM
    if not 1 < times <= wire_format.SCALE_MAX_MM / wire_format.SCALE_MM:
        return wire_format.SCALE_MM
    return math.ceil(times) * wire_format.SCALE_MM


def encode_height(result: Reconstruction, **taken: Unpack[Taken]) -> bytes:
    """The ``height`` payload of a reconstruction."""
    return encode_grid(wire_format.HEIGHT, result, result.height.height_mm, **taken)


def encode_shear(result: Reconstruction, **taken: Unpack[Taken]) -> bytes:
    """The ``shear`` payload of a reconstruction with shear:
    x, y of each cell.
    """
    assert result.shear_mm is not None
    return encode_grid(wire_format.SHEAR, result, result.shear_mm, **taken)


def encode_sigma(result: Reconstruction, **taken: Unpack[Taken]) -> bytes:
    """The ``sigma`` payload of a reconstruction with sigma."""
    assert result.sigma_mm is not None
    return encode_grid(wire_format.SIGMA, result, result.sigma_mm, **taken)


def encode_cloud(result: Reconstruction, **taken: Unpack[Taken]) -> bytes:
    """The ``cloud`` payload of a reconstruction; the grid fields of its header are 0."""
    return _pack(
        wire_format.CLOUD, result, taken, *_cloud(result.cloud.points_mm, result.cloud.labels)
    )


def encode_map_cloud(
    points_mm: F32, *, revision: int, calibration_crc32: int, t_ns: int, wall_ns: int
) -> bytes:
    """The ``map/cloud`` payload: a ``cloud`` of points (N, 3) in the base frame,
    with the revision as its sequence.
    """
    fields = Header(
        seq=revision,
        calibration_crc32=calibration_crc32,
        t_ns=t_ns,
        wall_ns=wall_ns,
        contact=True,
        invalid=False,
        saturated=False,
        degraded=False,
        touched=False,
        pose=None,
        pose_error_us=0,
    )
    shape, grid, data = _cloud(points_mm, np.ones(len(points_mm), np.uint16))
    return pack(wire_format.CLOUD, shape, grid, data, fields)


def _cloud(
    points_mm: F32, labels: U16
) -> tuple[tuple[int, int], tuple[float, float, float, float], bytes]:
    data = (
        points_mm.astype("<f4", copy=False).tobytes() + labels.astype("<u2", copy=False).tobytes()
    )
    # The header has no field for a number of points: its two sides hold the halves.
    return (len(labels) & wire_format.SIDE_MAX, len(labels) >> 16), _NO_GRID, data


def _pack(
    kind: int,
    result: Reconstruction,
    taken: Taken,
    shape: tuple[int, int],
    grid: tuple[float, float, float, float],
    data: bytes,
) -> bytes:
    fields = Header(
        seq=result.seq,
        calibration_crc32=taken["calibration_crc32"],
        t_ns=result.t_ns,
        wall_ns=result.wall_ns,
        contact=result.contact,
        invalid=not result.valid,
        saturated=result.saturated,
        degraded=result.degraded is not None,
        touched=result.touched,
        pose=taken.get("pose"),
        pose_error_us=taken.get("pose_error_us", 0),
    )
    return pack(kind, shape, grid, data, fields)
