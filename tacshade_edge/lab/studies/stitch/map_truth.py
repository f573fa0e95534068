"""Judge a map by a known surface, beside the paper's average of the same presses,
in figures and in a picture.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.drawing import BAR_WIDTH_PX, Axis, framed
from tacshade_edge.files.file_kinds import kind_at
from tacshade_edge.files.npz import numbers, read_arrays
from tacshade_edge.stitching.stitcher import Raster
from tacshade_edge.types import F32, F64, U8

_BYTES_MAX = 64 << 20
_STEP_MIN_MM = 0.001
# A 100 mm square at 0.05 mm: more is a mistake in the step, and would fill the memory.
_CELLS_MAX = 1 << 22


@dataclass(frozen=True, slots=True)
class Score:
    """The accuracy of a map: errors of heights in its cells, and what it covers."""

    rms_mm: float
    mean_mm: float
    p95_mm: float  # of absolute errors
    outside_cells: int  # beyond the known surface
    covered_mm2: float
    raised_coverage: float  # part of the surface above half its height that the map covers
    raised_rms_mm: float
    raised_mean_mm: float

    def as_json(self) -> dict[str, Any]:
        """The score for JSON, rounded to 0.1 µm."""
        return {
            key: round(value, 4) if math.isfinite(value) else None
            for key, value in asdict(self).items()
        }


def read_known(path: Path) -> Raster:
    """Read PAD.npz. Raises ConfigError if it is not readable, or not a map."""
    try:
        # A stranger's file: it must not ask for all memory.
        npz = read_arrays(path, _BYTES_MAX)
        x0, y0, step = (float(numbers(npz, key, 0)) for key in ("x0_mm", "y0_mm", "step_mm"))
        z = numbers(npz, "z_mm", 2, nan=True)
        if z.size > _CELLS_MAX or not np.isfinite(z).any() or step < _STEP_MIN_MM:
            found = f"z_mm of shape {z.shape} at steps of {step:g} mm"
            expected = (
                f"heights in at most {_CELLS_MAX} cells, and a step of at least {_STEP_MIN_MM:g} mm"
            )
            raise DecodeError(f"found {found}, expected {expected}")
        return Raster(z.astype(np.float32), x0, y0, step)
    except OSError as error:
        raise ConfigError(
            f"{path}: {error.strerror or error}, expected a known surface (.npz)"
        ) from None
    except (DecodeError, KeyError) as error:
        kind = kind_at(path)
        found = f"{kind} is no known surface" if kind else f"the file is no known surface: {error}"
        raise ConfigError(
            f"{path}: {found}; expected the keys z_mm, x0_mm, y0_mm and step_mm"
        ) from None


def score(found: Raster, known: Raster) -> Score:
    """Compare a map cell by cell with the nearest known height.

    Raises ConfigError if they share no cell.
    """
    true = at_cells_of(known, found)
    covered = np.isfinite(found.z_mm)
    both = covered & np.isfinite(true)
    if not both.any():
        raise ConfigError(
            "the known surface and the map share no cell; are the poses in the surface's frame?"
        )
    error = found.z_mm[both].astype(np.float64) - true[both]
    # Half the height of the bulges, wherever the frame has its origin.
    low, high = float(np.nanmin(known.z_mm)), float(np.nanmax(known.z_mm))
    half = (low + high) / 2
    with np.errstate(invalid="ignore"):
        # Bulges apart: a map of nothing but the plate would otherwise look accurate.
        raised = known.z_mm > half
        over = true[both] > half
    there = np.isfinite(at_cells_of(found, known))
    return Score(
        rms_mm=_rms(error),
        mean_mm=float(error.mean()),
        p95_mm=float(np.percentile(np.abs(error), 95)),
        outside_cells=int(np.count_nonzero(covered & ~both)),
        covered_mm2=float(np.count_nonzero(both)) * found.step_mm**2,
        raised_coverage=float(there[raised].mean()) if raised.any() else float("nan"),
        raised_rms_mm=_rms(error[over]) if over.any() else float("nan"),
        raised_mean_mm=float(error[over].mean()) if over.any() else float("nan"),
    )


def at_cells_of(values: Raster, places: Raster) -> F32:
    """Heights of the nearest cells of one raster at the cells of another; NaN beyond it."""
    rows, cols = places.z_mm.shape
    indices = []
    for first, own, count, size in (
        (places.y0_mm, values.y0_mm, rows, values.z_mm.shape[0]),
        (places.x0_mm, values.x0_mm, cols, values.z_mm.shape[1]),
    ):
        # The nearest cell, without interpolation: between cells, a map claims nothing.
        index = np.rint((first + np.arange(count) * places.step_mm - own) / values.step_mm).astype(
            np.int64
        )
        # Beyond the raster, the index of the padding, which is NaN.
        indices.append(np.where((index < 0) | (index >= size), size, index))
    padded = np.pad(values.z_mm, ((0, 1), (0, 1)), constant_values=np.nan)
    return np.asarray(padded[np.ix_(*indices)])


def _rms(values: F64) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


_PANEL_PX = 600  # greatest width of a surface with fewer cells
_ERROR_MM = 0.5
# Range beyond the known heights that the colours distinguish.
_BEYOND_MM = 0.3
_UNTOUCHED_GREY = 225


def comparison_png(known: Raster, found: Raster, average: Raster) -> bytes:
    """The picture over the known surface, seen from above with y upwards and axes in mm;
    three panels share colours.
    """
    span_mm = float(np.nanmin(known.z_mm)) - _BEYOND_MM, float(np.nanmax(known.z_mm)) + _BEYOND_MM
    ours, theirs = at_cells_of(found, known), at_cells_of(average, known)
    # White in the middle: only what is wrong has a colour.
    up = np.minimum(2 * np.arange(256), 255)
    viridis = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[:, 0]
    blue_white_red = np.stack((up[::-1], np.minimum(up, up[::-1]), up), axis=1).astype(np.uint8)
    panels = [
        _panel("known surface, z (mm)", known, known.z_mm, span_mm, viridis),
        _panel("map, z (mm)", known, ours, span_mm, viridis),
        _panel("the paper's average, z (mm)", known, theirs, span_mm, viridis),
        _panel(
            "map minus known surface (mm)",
            known,
            ours - known.z_mm,
            (-_ERROR_MM, _ERROR_MM),
            blue_white_red,
        ),
    ]
    return cv2.imencode(".png", np.vstack((np.hstack(panels[:2]), np.hstack(panels[2:]))))[
        1
    ].tobytes()


def _panel(title: str, grid: Raster, z_mm: F32, span: tuple[float, float], colours: U8) -> U8:
    """Values on the cells of `grid` in colours, grey where there are none,
    beside the bar of their span.
    """
    zoom = max(1, _PANEL_PX // z_mm.shape[1])
    level = np.nan_to_num(np.clip((z_mm - span[0]) / (span[1] - span[0]), 0, 1) * 255).astype(
        np.uint8
    )
    picture = colours[level]
    picture[~np.isfinite(z_mm)] = _UNTOUCHED_GREY
    # Rows of pictures go down, y goes up.
    picture = np.flipud(picture).repeat(zoom, axis=0).repeat(zoom, axis=1)
    per_px, (rows, _) = grid.step_mm / zoom, picture.shape[:2]
    half = (grid.step_mm - per_px) / 2
    x = Axis("x (mm)", grid.x0_mm - half, per_px)
    y = Axis("y (mm)", grid.y0_mm - half + (rows - 1) * per_px, -per_px)
    bar = colours[np.linspace(255, 0, rows).astype(np.uint8)][:, None].repeat(BAR_WIDTH_PX, axis=1)
    scale = framed(bar, None, Axis("", span[1], -(span[1] - span[0]) / (rows - 1)))
    return np.hstack((framed(picture, x, y, title), scale))
