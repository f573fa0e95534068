"""A stitched map as files (map.npz, map.ply, map.png and map.json, preview.png),
and ``flange.json``.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tacshade_edge.files import meshes
from tacshade_edge.files.atomic_files import disk_errors, write_set, write_whole
from tacshade_edge.reasons import text_of
from tacshade_edge.stitching.flange import ORDER, FoundFlange
from tacshade_edge.stitching.map_picture import height_span_mm, preview
from tacshade_edge.stitching.stitcher import BAND_ROWS, PlacedPress, Raster
from tacshade_edge.types import F32, F64

_PNG_SCALE_MM = 0.001


def press_record(press: PlacedPress) -> dict[str, Any]:
    """The record of a press in ``map.json``."""
    return {
        "used": press.rejected is None,
        "reason": text_of(press.rejected),
        "points": press.points,
        "moved_mm": round(press.correction_mm, 4),
        "turned_deg": round(press.correction_deg, 4),
    }


def write_map(
    folder: Path,
    raster: Raster,
    details: Mapping[str, Any],
    more: Mapping[str, bytes] = MappingProxyType({}),
) -> None:
    """Write all files of a map, so that files beside a ``map.json`` (with the additional keys
    `details`) are of one map, also after a kill; those of an older map stay whole until then,
    beside them or in ``map-previous``.

    Raises DeviceError.
    """
    levels, z0_mm, scale_mm = _levels(raster.z_mm)
    about = {
        "x0_mm": raster.x0_mm,
        "y0_mm": raster.y0_mm,
        "step_mm": raster.step_mm,
        "rows": raster.z_mm.shape[0],
        "cols": raster.z_mm.shape[1],
        "touched_mm2": float(np.count_nonzero(levels)) * raster.step_mm**2,
        # In map.png, 0 is untouched and level n is z0_mm + (n - 1) scale_mm.
        "png": {"z0_mm": z0_mm, "scale_mm": scale_mm},
        **details,
    }
    png = cv2.imencode(".png", levels)[1].tobytes()
    # 30 MB of a large map, while the next file is compressed.
    del levels
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, z_mm=raster.z_mm, x0_mm=raster.x0_mm, y0_mm=raster.y0_mm, step_mm=raster.step_mm
    )
    files: dict[str, bytes | Iterable[bytes]] = {
        "map.npz": buffer.getvalue(),
        "map.ply": _points(raster),
        "map.png": png,
        "preview.png": cv2.imencode(".png", preview(raster))[1].tobytes(),
        **more,
    }
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        # map.json last: where it is, the files beside it are whole and of the same map.
        write_set(folder, files, "map.json", (json.dumps(about, indent=2) + "\n").encode())


def _points(raster: Raster) -> Iterator[bytes]:
    """The touched cells as a PLY file, in parts."""
    count = sum(int(np.count_nonzero(np.isfinite(band.z_mm))) for band in raster.bands())
    yield meshes.ply_head(count, "millimetres, base frame")
    for band in raster.bands():
        yield meshes.ply_rows(band.points())


def _levels(z_mm: F32) -> tuple[NDArray[np.uint16], float, float]:
    """16-bit levels, the z of level 1 and the step in mm;
    the step grows with the range of heights if necessary.
    """
    low, high = height_span_mm(z_mm)
    scale_mm = max(_PNG_SCALE_MM, (high - low) / 65534)
    levels = np.empty(z_mm.shape, np.uint16)
    for first in range(0, len(z_mm), BAND_ROWS):
        band = z_mm[first : first + BAND_ROWS]
        level = np.rint((np.nan_to_num(band, nan=low) - low) / scale_mm) + 1
        levels[first : first + BAND_ROWS] = np.where(np.isfinite(band), level, 0)
    return levels, low, scale_mm


FLANGE = "flange.json"


def write_flange(
    folder: Path, found: FoundFlange, *, delay_seen: bool, presses: int, frames: int
) -> None:
    """Write ``flange.json`` whole; values of an unobserved delay are null. Raises DeviceError."""
    covariance = found.covariance.copy()
    if not delay_seen:
        covariance[-1] = covariance[:, -1] = np.nan
    about = {
        "flange_T_sensor": [round(value, 6) for value in found.flange_T_sensor.seven()],
        "delay_ms": round(found.delay_ms, 3) if delay_seen else None,
        "order": ORDER,
        "sigma": _numbers(np.sqrt(np.diag(covariance))),
        "covariance": [_numbers(row) for row in covariance],
        "presses": presses,
        "frames": frames,
        "left_mm": round(found.left_mm, 4),
    }
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / FLANGE, (json.dumps(about, indent=2) + "\n").encode())


def _numbers(values: F64) -> list[float | None]:
    return [float(f"{value:.4g}") if np.isfinite(value) else None for value in values.tolist()]
