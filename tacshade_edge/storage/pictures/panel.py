"""A picture of one reconstruction for people: the image, the height in colours, the contact's outline."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.errors import DeviceError
from tacshade_edge.reasons import text_of
from tacshade_edge.storage.pictures.axes import Axis, colour_bar, framed
from tacshade_edge.types import U8, Geometry, HeightMap, Reconstruction

_LEGEND_PX = 22
_COLOURS = cv2.COLORMAP_VIRIDIS


def write_panel(path: Path, image: U8, result: Reconstruction, geometry: Geometry) -> None:
    """Write the image and the height map side by side, each with axes.

    Raises
    ------
    DeviceError
        The file cannot be written.
    """
    ok, data = cv2.imencode(".png", panel(image, result, geometry))
    if not ok:
        raise DeviceError(f"{path}: cannot encode the picture")
    path.write_bytes(data.tobytes())


def panel(image: U8, result: Reconstruction, geometry: Geometry) -> U8:
    """The picture, uint8 (rows, cols, 3) BGR: the image with axes in px, the height in mm with axes and a colour bar.

    The axes measure mm in the plane of the visible circle (`Geometry.mm_per_px`), from its centre.
    """
    left = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
    rows, cols = left.shape[:2]
    height, size = result.height.height_mm, (cols, rows)
    top = max(float(np.nanmax(height, initial=0.0)), 0.1)
    level = np.nan_to_num(np.clip(height / top, 0, 1) * 255).astype(np.uint8)
    right = cv2.applyColorMap(_over_image(level, result.height, size, cv2.INTER_LINEAR), _COLOURS)
    seen = _over_image(np.isfinite(height).astype(np.uint8), result.height, size, cv2.INTER_NEAREST)
    right[seen == 0] = 255
    touched = _over_image(result.height.contact.astype(np.uint8), result.height, size, cv2.INTER_NEAREST)
    outlines, _ = cv2.findContours(touched, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(right, outlines, -1, (255, 255, 255), 1)
    text = text_of(result.reason) or (
        f"{result.profile}: {len(result.objects)} objects, deepest {result.depth_max_mm:.2f} mm"
        f"{' SATURATED' if result.saturated else ''} {text_of(result.degraded)}"
        if result.contact
        else f"{result.profile}: no contact {text_of(result.degraded)}"
    )
    disc, mm = geometry.disc, geometry.mm_per_px
    pictures = np.hstack(
        [
            framed(left, Axis("col (px)"), Axis("row (px)")),
            framed(right, Axis("x (mm)", -disc.col_c * mm, mm), Axis("y (mm)", -disc.row_c * mm, mm)),
            colour_bar(_COLOURS, rows, top, "h (mm)"),
        ]
    )
    legend = np.full((_LEGEND_PX, pictures.shape[1], 3), 255, dtype=np.uint8)
    cv2.putText(legend, text[:120], (6, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    picture: U8 = np.vstack([pictures, legend])
    return picture


def _over_image(values: U8, grid: HeightMap, size: tuple[int, int], interpolation: int) -> U8:
    """The values of a map's cells resampled to an image of `size` (width, height); 0 outside the map."""
    to_cell = np.array(((1, 0, -grid.col0), (0, 1, -grid.row0))) / grid.step_px
    return np.asarray(cv2.warpAffine(values, to_cell, size, flags=interpolation | cv2.WARP_INVERSE_MAP), np.uint8)
