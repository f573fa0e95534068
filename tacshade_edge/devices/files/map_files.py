"""A stitched map as files: map.npz, map.ply, map.png and map.json, preview.png."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tacshade_edge.core.stitching.surface_map import Raster
from tacshade_edge.devices.files.whole_files import disk_errors, write_whole
from tacshade_edge.types import F32, U8

_PNG_SCALE_MM = 0.001
_PREVIEW_PX = 900  # of the longer side, at most
_LEGEND_PX = 24
_UNTOUCHED_GREY = 225


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
    known = np.isfinite(raster.z_mm)
    about = {
        "x0_mm": raster.x0_mm,
        "y0_mm": raster.y0_mm,
        "step_mm": raster.step_mm,
        "rows": raster.z_mm.shape[0],
        "cols": raster.z_mm.shape[1],
        "touched_mm2": float(np.count_nonzero(known)) * raster.step_mm**2,
        # Of map.png: 0 is untouched, level n is z0_mm + (n - 1) scale_mm.
        "png": {"z0_mm": z0_mm, "scale_mm": scale_mm},
        **details,
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, z_mm=raster.z_mm, x0_mm=raster.x0_mm, y0_mm=raster.y0_mm, step_mm=raster.step_mm)
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / "map.npz", buffer.getvalue())
        write_whole(folder / "map.ply", ply(raster))
        write_whole(folder / "map.png", cv2.imencode(".png", levels)[1].tobytes())
        write_whole(folder / "preview.png", cv2.imencode(".png", preview(raster))[1].tobytes())
        write_whole(folder / "map.json", (json.dumps(about, indent=2) + "\n").encode())


def ply(raster: Raster) -> bytes:
    """The touched cells as a binary PLY of points: x, y, z in mm, base frame."""
    points = raster.points().astype("<f4")
    head = f"ply\nformat binary_little_endian 1.0\ncomment millimetres, base frame\nelement vertex {len(points)}\n"
    return (head + "property float x\nproperty float y\nproperty float z\nend_header\n").encode() + points.tobytes()


def preview(raster: Raster) -> U8:
    """A picture for a person, as seen from above, y upwards: heights in colours, grey where nothing was touched."""
    z = raster.z_mm
    low, high = _span(z)
    level = np.nan_to_num(np.clip((z - low) / max(high - low, 0.1) * 255, 0, 255)).astype(np.uint8)
    picture = cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS)
    picture[~np.isfinite(z)] = _UNTOUCHED_GREY
    zoom = max(1, _PREVIEW_PX // max(z.shape))
    picture = np.flipud(picture).repeat(zoom, axis=0).repeat(zoom, axis=1)
    if max(picture.shape[:2]) > _PREVIEW_PX:
        size = tuple(max(1, round(s * _PREVIEW_PX / max(picture.shape[:2]))) for s in picture.shape[1::-1])
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    legend = np.full((_LEGEND_PX, picture.shape[1], 3), 255, np.uint8)
    width, height = (s * raster.step_mm for s in z.shape[1::-1])
    text = f"{width:.0f} x {height:.0f} mm, colours {low:.2f} to {high:.2f} mm" if low < high else "nothing touched"
    cv2.putText(legend, text, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack((picture, legend))


def _span(z_mm: F32) -> tuple[float, float]:
    known = z_mm[np.isfinite(z_mm)]
    return (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)


def _levels(z_mm: F32) -> tuple[np.typing.NDArray[np.uint16], float, float]:
    """16-bit levels, the z of level 1 and the step in mm; the step grows where the heights need it."""
    low, high = _span(z_mm)
    scale_mm = max(_PNG_SCALE_MM, (high - low) / 65534)
    levels = np.where(np.isfinite(z_mm), np.rint((np.nan_to_num(z_mm, nan=low) - low) / scale_mm) + 1, 0)
    return levels.astype(np.uint16), low, scale_mm
