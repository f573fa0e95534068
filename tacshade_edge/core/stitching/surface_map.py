"""A height map of a surface, on a grid in the base frame that grows in tiles: a press costs what it covers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tacshade_edge.types import F32, F64, I64, freeze

STEP_MM = 0.25
"""About the sensor's own cells on the skin (0.28 mm at a radius of 20 mm): what is coarser smears walls."""
TILE = 64
PRESS_WIDTH_MAX_MM = 200.0
"""No sensor touches more at once."""
TILES_MAX = 1024
"""Of 64 KiB, 16 mm wide: half a metre square, 64 MiB."""
_POSITION_MAX_MM = 1e6
EXTENT_MAX_TILES = 4096
"""In the map's bounding box, a square metre: its raster has 64 MiB."""
MIN_WEIGHT = 0.07
"""A cell of less lies beside the contact."""


@dataclass(frozen=True, slots=True, eq=False)
class Raster:
    """A map as one array.

    Attributes
    ----------
    z_mm : float32 (rows, cols)
        In the base frame; NaN where nothing was touched.
    x0_mm, y0_mm, step_mm : float
        Row i is at y0 + i step, column j at x0 + j step.
    """

    z_mm: F32
    x0_mm: float
    y0_mm: float
    step_mm: float

    def __post_init__(self) -> None:
        freeze(self, "z_mm")

    def points(self) -> F64:
        """The touched cells as points (N, 3), mm."""
        i, j = np.nonzero(np.isfinite(self.z_mm))
        return np.stack((self.x0_mm + j * self.step_mm, self.y0_mm + i * self.step_mm, self.z_mm[i, j]), axis=1)


@dataclass(frozen=True, slots=True)
class _Overlap:
    """The nodes that a window and a tile share: their rows and columns in the tile, and those in the window."""

    tile: tuple[int, int]
    in_tile: tuple[slice, slice]
    in_window: tuple[slice, slice]


@dataclass(frozen=True, slots=True)
class _Window:
    """`rows` x `cols` nodes from (`row`, `col`) on."""

    row: int
    col: int
    rows: int
    cols: int

    def overlaps(self) -> Iterator[_Overlap]:
        """With each tile that it lies in."""
        for tile_row, rows_in_tile, rows in _spans(self.row, self.rows):
            for tile_col, cols_in_tile, cols in _spans(self.col, self.cols):
                yield _Overlap((tile_row, tile_col), (rows_in_tile, cols_in_tile), (rows, cols))


def _spans(first: int, count: int) -> Iterator[tuple[int, slice, slice]]:
    """Tile number, indices in the tile and indices from `first` on, along one axis."""
    for tile in range(first // TILE, (first + count - 1) // TILE + 1):
        start, end = max(first, tile * TILE), min(first + count, (tile + 1) * TILE)
        yield tile, slice(start - tile * TILE, end - tile * TILE), slice(start - first, end - first)


class SurfaceMap:
    """Weighted means of z at the nodes of a grid, each point shared bilinearly by the four around it.

    Means are kept as running sums of weight and weight · z, as in Curless and Levoy, "A volumetric method for building
    complex models from range images", SIGGRAPH 1996. Nodes without a point stay holes.

    Parameters
    ----------
    step_mm : float
    bounded : bool
        False for what was in a bounded map already.

    Raises
    ------
    ValueError
        From `add`: a point is not finite, points lie more than `PRESS_WIDTH_MAX_MM` apart, or the map would get more
        than `TILES_MAX` tiles or spread over more than `EXTENT_MAX_TILES`; nothing was added then.
    """

    def __init__(self, step_mm: float = STEP_MM, *, bounded: bool = True) -> None:
        self._bounded = bounded
        self.step_mm = step_mm
        self._extent: tuple[int, int, int, int] | None = None  # first and last row and column of tiles
        self._tiles: dict[tuple[int, int], F64] = {}  # (weight, weight · z) of TILE x TILE nodes

    def add(self, points_mm: F64, weight: F32 | F64) -> None:
        """Fuse points (N, 3) in the base frame with their weights (N,)."""
        if not (np.abs(points_mm) < _POSITION_MAX_MM).all():
            raise ValueError(f"a point is not finite, or over {_POSITION_MAX_MM / 1000:g} m from the base")
        if len(points_mm) == 0:
            return
        corner = np.floor(points_mm[:, :2] / self.step_mm)
        along, across = (points_mm[:, :2] / self.step_mm - corner).T
        j, i = corner.T.astype(np.int64)
        window = self._window(i, j)
        rows, cols = window.rows, window.cols
        cell = (i - window.row) * cols + (j - window.col)
        sums = np.zeros((2, rows * cols))
        shares = ((0, (1 - along) * (1 - across)), (1, along * (1 - across)))
        for offset, share in (*shares, (cols, (1 - along) * across), (cols + 1, along * across)):
            w = weight * share
            sums[0] += np.bincount(cell + offset, w, rows * cols)
            sums[1] += np.bincount(cell + offset, w * points_mm[:, 2], rows * cols)
        overlaps = [overlap for overlap in window.overlaps() if sums[0].reshape(rows, cols)[overlap.in_window].any()]
        if not overlaps:
            return
        missing = [overlap.tile for overlap in overlaps if overlap.tile not in self._tiles]
        if self._bounded and len(self._tiles) + len(missing) > TILES_MAX:
            raise ValueError(f"the map would get larger than {TILES_MAX} tiles of {TILE * self.step_mm:g} mm")
        extent = _box([overlap.tile for overlap in overlaps], self._extent)
        if self._bounded and (extent[2] - extent[0] + 1) * (extent[3] - extent[1] + 1) > EXTENT_MAX_TILES:
            raise ValueError(
                f"the map would spread over more than {EXTENT_MAX_TILES} tiles of {TILE * self.step_mm:g} mm: "
                "a pose is far from the others"
            )
        self._extent = extent
        for tile in missing:
            self._tiles[tile] = np.zeros((2, TILE, TILE))
        for overlap in overlaps:
            self._tiles[overlap.tile][:, *overlap.in_tile] += sums.reshape(2, rows, cols)[:, *overlap.in_window]

    def z_at(self, points_mm: F64) -> F64:
        """The map's z at the nodes nearest to points (N, 3), mm; NaN where it has none."""
        if len(points_mm) == 0:
            return np.zeros(0)
        j, i = np.rint(points_mm[:, :2].T / self.step_mm).astype(np.int64)
        window = self._window(i, j)
        sums = np.zeros((2, window.rows, window.cols))
        for overlap in window.overlaps():
            if overlap.tile in self._tiles:
                sums[:, *overlap.in_window] = self._tiles[overlap.tile][:, *overlap.in_tile]
        weight, total = sums[:, i - window.row, j - window.col]
        z: F64 = np.divide(total, weight, out=np.full(len(points_mm), np.nan), where=weight > 0)
        return z

    def _window(self, i: I64, j: I64) -> _Window:
        """The nodes from the least to one after the greatest row and column."""
        top, left, bottom, right = int(i.min()), int(j.min()), int(i.max()), int(j.max())
        if max(bottom - top, right - left) * self.step_mm > PRESS_WIDTH_MAX_MM:
            raise ValueError(f"the points of one press are more than {PRESS_WIDTH_MAX_MM:g} mm apart")
        return _Window(top, left, bottom - top + 2, right - left + 2)

    @property
    def tiles(self) -> int:
        """How many there are; each is 64 KiB."""
        return len(self._tiles)

    def raster(self, min_weight: float = MIN_WEIGHT) -> Raster:
        """The map's bounding box as one array; a single empty cell while nothing was touched.

        Parameters
        ----------
        min_weight : float
            Cells of less weight are left out.
        """
        whole = np.zeros((0, 0), np.float32)
        top, left, bottom, right = self._extent or (0, 0, -1, -1)
        if self._tiles:
            whole = np.full(((bottom - top + 1) * TILE, (right - left + 1) * TILE), np.nan, np.float32)
        for (i, j), (weight, total) in self._tiles.items():
            tile = whole[(i - top) * TILE : (i - top + 1) * TILE, (j - left) * TILE : (j - left + 1) * TILE]
            np.divide(total, weight, out=tile, where=weight >= min_weight, casting="unsafe")
        known = np.isfinite(whole)
        rows, cols = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        if not rows.size:
            return Raster(np.full((1, 1), np.nan, np.float32), 0.0, 0.0, self.step_mm)
        return Raster(
            whole[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1].copy(),
            (left * TILE + int(cols[0])) * self.step_mm,
            (top * TILE + int(rows[0])) * self.step_mm,
            self.step_mm,
        )


def _box(tiles: list[tuple[int, int]], before: tuple[int, int, int, int] | None) -> tuple[int, int, int, int]:
    """First and last row and column of tiles, and of those before."""
    rows, cols = [row for row, _ in tiles], [col for _, col in tiles]
    if before is not None:
        rows += before[::2]
        cols += before[1::2]
    return min(rows), min(cols), max(rows), max(cols)
