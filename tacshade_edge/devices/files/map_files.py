"""A stitched map as files: map.npz, map.ply, map.png and map.json, preview.png."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tacshade_edge.core.stitching.stitcher import PlacedPress
from tacshade_edge.core.stitching.surface_map import BAND_ROWS, Raster
from tacshade_edge.devices.files import ply
from tacshade_edge.devices.files.whole_files import disk_errors, write_whole
from tacshade_edge.reasons import text_of
from tacshade_edge.types import F32, U8

_PNG_SCALE_MM = 0.001
_PREVIEW_PX = 900  # of the longer side, at most
_LEGEND_PX = 24
_UNTOUCHED_GREY = 225


def press_record(press: PlacedPress) -> dict[str, Any]:
    """What ``map.json`` tells of a press in the map."""
    return {
        "used": press.rejected is None,
        "reason": text_of(press.rejected),
        "points": press.points,
        "moved_mm": round(press.correction_mm, 4),
        "turned_deg": round(press.correction_deg, 4),
    }


def write_map(folder: Path, raster: Raster, details: Mapping[str, Any]) -> None:
    """Write all files of a map; each is there whole or not at all.

    Parameters
    ----------
    folder : Path
        Made when missing.
    raster : Raster
    details : mapping
        More keys of ``map.json``.

    Raises
    ------
    DeviceError
        The folder cannot be written.
    """
    levels, z0_mm, scale_mm = _levels(raster.z_mm)
    about = {
        "x0_mm": raster.x0_mm,
        "y0_mm": raster.y0_mm,
        "step_mm": raster.step_mm,
        "rows": raster.z_mm.shape[0],
        "cols": raster.z_mm.shape[1],
        "touched_mm2": float(np.count_nonzero(levels)) * raster.step_mm**2,
        # Of map.png: 0 is untouched, level n is z0_mm + (n - 1) scale_mm.
        "png": {"z0_mm": z0_mm, "scale_mm": scale_mm},
        **details,
    }
    png = cv2.imencode(".png", levels)[1].tobytes()
    del levels  # of a large map 30 MB
    buffer = io.BytesIO()
    np.savez_compressed(buffer, z_mm=raster.z_mm, x0_mm=raster.x0_mm, y0_mm=raster.y0_mm, step_mm=raster.step_mm)
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / "map.npz", buffer.getvalue())
        write_whole(folder / "map.ply", _points(raster))
        write_whole(folder / "map.png", png)
        write_whole(folder / "preview.png", cv2.imencode(".png", preview(raster))[1].tobytes())
        write_whole(folder / "map.json", (json.dumps(about, indent=2) + "\n").encode())


def _points(raster: Raster) -> Iterator[bytes]:
    """The touched cells as PLY, in parts."""
    count = sum(int(np.count_nonzero(np.isfinite(band.z_mm))) for band in raster.bands())
    yield ply.head(count, "millimetres, base frame")
    for band in raster.bands():
        yield ply.rows(band.points())


def preview(raster: Raster) -> U8:
    """A picture for a person, as seen from above, y upwards: heights in colours, grey where nothing was touched."""
    low, high = _span(raster.z_mm)
    stride = max(1, max(raster.z_mm.shape) // (2 * _PREVIEW_PX))  # of a large map some cells are enough
    z = raster.z_mm[::stride, ::stride]
    level = np.nan_to_num(np.clip((z - low) / max(high - low, 0.1) * 255, 0, 255)).astype(np.uint8)
    picture = np.asarray(cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS), np.uint8)
    picture[~np.isfinite(z)] = _UNTOUCHED_GREY
    if max(z.shape) > _PREVIEW_PX:
        size = tuple(max(1, round(s * _PREVIEW_PX / max(z.shape))) for s in z.shape[::-1])
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    zoom = max(1, _PREVIEW_PX // max(z.shape))
    picture = np.flipud(picture).repeat(zoom, axis=0).repeat(zoom, axis=1)
    legend = np.full((_LEGEND_PX, picture.shape[1], 3), 255, np.uint8)
    width, height = (s * raster.step_mm for s in raster.z_mm.shape[1::-1])
    text = f"{width:.0f} x {height:.0f} mm, colours {low:.2f} to {high:.2f} mm" if low < high else "nothing touched"
    cv2.putText(legend, text, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack((picture, legend))


def _span(z_mm: F32) -> tuple[float, float]:
    low, high = float(np.fmin.reduce(z_mm, axis=None)), float(np.fmax.reduce(z_mm, axis=None))
    return (low, high) if math.isfinite(low) else (0.0, 0.0)


def _levels(z_mm: F32) -> tuple[NDArray[np.uint16], float, float]:
    """16-bit levels, the z of level 1 and the step in mm; the step grows where the heights need it."""
    low, high = _span(z_mm)
    scale_mm = max(_PNG_SCALE_MM, (high - low) / 65534)
    levels = np.empty(z_mm.shape, np.uint16)
    for first in range(0, len(z_mm), BAND_ROWS):
        band = z_mm[first : first + BAND_ROWS]
        level = np.rint((np.nan_to_num(band, nan=low) - low) / scale_mm) + 1
        levels[first : first + BAND_ROWS] = np.where(np.isfinite(band), level, 0)
    return levels, low, scale_mm
