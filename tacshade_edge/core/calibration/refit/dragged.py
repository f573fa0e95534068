"""Show a press as if its indenter had dragged the skin, by warping the press's own picture.

An indenter that sticks takes the skin under it along. Next to it, the displacement decays over a length λt towards the
sway of the whole dome (`simulator.drag`), and ends at the rim. Picture and known h move alike, so presses straight down
also show how the network has to read drags. Changes of light and of perspective over a few mm are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.core.geometry.disc import Grid
from tacshade_edge.types import F32, U8, Bool, Disc, Geometry

LONGEST_MM, DECAY_MM, MOST_SWAY = 4.0, (2.0, 8.0), 0.4
"""Longest drag and range of λt (mm on the nominal skin), and the greatest part of a drag that the whole dome takes."""


@dataclass(frozen=True, slots=True)
class Drag:
    """A drag in the image.

    Attributes
    ----------
    row_px, col_px : float
        How far the indenter moves.
    decay_px : float
        λt.
    sway : float
        Part of the drag that the whole dome takes, 0 to 1.
    """

    row_px: float
    col_px: float
    decay_px: float
    sway: float


def px_per_mm(geometry: Geometry) -> float:
    """Pixels per mm at the tip of the undeformed skin."""
    if geometry.camera_distance_mm is None:
        return 1 / geometry.mm_per_px
    return geometry.f_px / (geometry.skin_radius_mm + geometry.camera_distance_mm)


def random_drags(geometry: Geometry, count: int, rng: np.random.Generator) -> list[Drag]:
    """Draw drags in all directions."""
    px = skin_scale(geometry) * px_per_mm(geometry)
    drawn = []
    for _ in range(count):
        length_px, angle = float(rng.uniform(0, LONGEST_MM)) * px, float(rng.uniform(0, 2 * math.pi))
        decay_px, sway = float(rng.uniform(*DECAY_MM)) * px, float(rng.uniform(0, MOST_SWAY))
        drawn.append(Drag(length_px * math.sin(angle), length_px * math.cos(angle), decay_px, sway))
    return drawn


def moved_part(touched: Bool, disc: Disc, drag: Drag) -> F32:
    """Part of a drag by which the skin that each pixel shows after it has moved.

    Parameters
    ----------
    touched : bool (H, W)
        Pixels that show skin in contact before the drag.
    disc : Disc
    drag : Drag

    Returns
    -------
    float32 (H, W), 0 to 1
        0 outside the disc; inside, no pixel shows what was outside.
    """
    height, width = touched.shape
    shift = np.array(((1, 0, drag.col_px), (0, 1, drag.row_px)), np.float32)
    moved = cv2.warpAffine(touched.astype(np.uint8), shift, (width, height), flags=cv2.INTER_NEAREST)
    if not moved.any():  # dragged out of the image
        return np.zeros(touched.shape, np.float32)
    away_px: F32 = cv2.distanceTransform(1 - moved, cv2.DIST_L2, 5).astype(np.float32)
    part = drag.sway + (1 - drag.sway) * np.exp(-away_px / np.float32(drag.decay_px))
    rows, cols = np.ogrid[:height, :width]
    to_rim_px = disc.radius_px - np.hypot(rows - disc.row_c, cols - disc.col_c)
    fade_px = max(2 * math.hypot(drag.row_px, drag.col_px), 1.0)
    return np.asarray(part * np.clip(to_rim_px / fade_px, 0, 1), dtype=np.float32)


def dragged_picture(picture: U8, part: F32, drag: Drag) -> U8:
    """Warp a picture (H, W) or (H, W, 3) by `moved_part`."""
    rows, cols = (axis.astype(np.float32) for axis in np.indices(part.shape))
    source = rows - part * np.float32(drag.row_px), cols - part * np.float32(drag.col_px)
    warped: U8 = cv2.remap(picture, source[1], source[0], cv2.INTER_LINEAR)
    return warped


def dragged_map(map_: F32, part: F32, drag: Drag, grid: Grid, outside: float) -> F32:
    """Warp a map on a grid of the image by `moved_part` of the image; `outside` is its value beyond its edge."""
    height, width = part.shape
    at = np.clip(np.rint(grid.row0 + grid.step_px * np.arange(grid.rows)), 0, height - 1).astype(int)
    beside = np.clip(np.rint(grid.col0 + grid.step_px * np.arange(grid.cols)), 0, width - 1).astype(int)
    here = part[np.ix_(at, beside)] / np.float32(grid.step_px)
    rows, cols = (axis.astype(np.float32) for axis in np.indices(here.shape))
    source = rows - here * np.float32(drag.row_px), cols - here * np.float32(drag.col_px)
    warped: F32 = cv2.remap(
        map_.astype(np.float32), source[1], source[0], cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=outside,
    )  # fmt: skip
    return warped


def pixels_of(cells: Bool, grid: Grid, shape: tuple[int, int]) -> Bool:
    """The pixels (H, W) that cells of a grid cover; False beyond the grid."""
    rows = np.rint((np.arange(shape[0]) - grid.row0) / grid.step_px).astype(int)
    cols = np.rint((np.arange(shape[1]) - grid.col0) / grid.step_px).astype(int)
    held = ((rows >= 0) & (rows < grid.rows))[:, None] & ((cols >= 0) & (cols < grid.cols))[None, :]
    taken = cells[np.ix_(np.clip(rows, 0, grid.rows - 1), np.clip(cols, 0, grid.cols - 1))]
    return np.asarray(held & taken)
