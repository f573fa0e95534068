"""Draw the known surface, the map, the paper's average of the same presses, and the error in one picture."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.core.stitching.surface_map import Raster
from tacshade_edge.storage.atomic_files import disk_errors, write_whole
from tacshade_edge.studies.stitch.score import at_cells_of
from tacshade_edge.types import F32, U8

_PANEL_PX = 600  # greatest width of a surface with fewer cells
_ERROR_MM = 0.5
_BEYOND_MM = 0.3  # range beyond the known heights that the colours distinguish
_GAP_PX, _TITLE_PX = 10, 22
_UNTOUCHED_GREY = 225


def write_comparison(path: Path, known: Raster, found: Raster, average: Raster) -> None:
    """Write the picture, over the known surface, seen from above with y upwards.

    Raises
    ------
    DeviceError
        The file cannot be written.
    """
    with disk_errors(path.parent):
        write_whole(path, cv2.imencode(".png", comparison(known, found, average))[1].tobytes())


def comparison(known: Raster, found: Raster, average: Raster) -> U8:
    """The picture, uint8 (H, W, 3) BGR; the first three panels share one colour scale."""
    low, high = float(np.nanmin(known.z_mm)) - _BEYOND_MM, float(np.nanmax(known.z_mm)) + _BEYOND_MM
    ours, theirs = at_cells_of(found, known), at_cells_of(average, known)
    error = (ours - known.z_mm + _ERROR_MM) / (2 * _ERROR_MM)
    panels = [
        _panel("known surface", (known.z_mm - low) / (high - low), _viridis()),
        _panel("map", (ours - low) / (high - low), _viridis()),
        _panel("the paper's average", (theirs - low) / (high - low), _viridis()),
        _panel(f"map less known: blue -{_ERROR_MM:g}, red {_ERROR_MM:g} mm and more", error, _blue_white_red()),
    ]
    panels = [cv2.copyMakeBorder(p, 0, _GAP_PX, 0, _GAP_PX, cv2.BORDER_CONSTANT, value=(255, 255, 255)) for p in panels]
    return np.vstack((np.hstack(panels[:2]), np.hstack(panels[2:])))


def _viridis() -> U8:
    return np.asarray(cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS), np.uint8)


def _blue_white_red() -> U8:
    up = np.minimum(2 * np.arange(256), 255)
    return np.stack((up[::-1], np.minimum(up, up[::-1]), up), axis=1).astype(np.uint8)[:, None]


def _panel(title: str, part: F32, colours: U8) -> U8:
    """A panel of values from 0 to 1 in colours, under a title; grey where there are none."""
    level = np.nan_to_num(np.clip(part, 0, 1) * 255).astype(np.uint8)
    picture = colours[:, 0][level]
    picture[~np.isfinite(part)] = _UNTOUCHED_GREY
    zoom = max(1, _PANEL_PX // picture.shape[1])
    picture = np.flipud(picture).repeat(zoom, axis=0).repeat(zoom, axis=1)
    head = np.full((_TITLE_PX, picture.shape[1], 3), 255, np.uint8)
    cv2.putText(head, title, (4, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack((head, picture))
