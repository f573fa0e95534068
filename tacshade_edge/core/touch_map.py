"""A height map of what was touched, on a grid in the base frame that grows in tiles: a press costs what it covers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tacshade_edge.types import F32, F64, I64, Bool, freeze

STEP_MM = 0.25
"""About the sensor's own cells on the skin (0.28 mm at a radius of 20 mm): what is coarser smears walls."""
TILE = 64
MAX_TILES = 1024
"""Of 64 KiB, 16 mm wide: half a metre square, 64 MiB."""
LEAST_WEIGHT = 0.07
"""A cell of less was not touched, only neared."""


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


class TouchMap:
    """Weighted means of z at the nodes of a grid, each point shared by the four around it; holes stay holes.

    Raises
    ------
    ValueError
        From `add`: a point is not finite, or the map would get more than `MAX_TILES` tiles; nothing was added then.
    """

    def __init__(self, step_mm: float = STEP_MM) -> None:
        self.step_mm = step_mm
        self._tiles: dict[tuple[int, int], F64] = {}  # (weight, weight · z) of TILE² cells

    def add(self, points_mm: F64, weight: F32 | F64) -> None:
        """Fuse points (N, 3) in the base frame with their weights (N,)."""
        if not np.isfinite(points_mm).all():
            raise ValueError("a point is not finite")
        corner = np.floor(points_mm[:, :2] / self.step_mm)
        part = points_mm[:, :2] / self.step_mm - corner
        corner = corner.astype(np.int64)
        node = np.concatenate([corner + np.array(by) for by in ((0, 0), (1, 0), (0, 1), (1, 1))])
        along, across = part.T
        shares = ((1 - along) * (1 - across), along * (1 - across), (1 - along) * across, along * across)
        w = np.concatenate([weight * share for share in shares])
        wz = w * np.tile(points_mm[:, 2], 4)
        parts = list(_parts(node))
        missing = [tile for tile, _, _ in parts if tile not in self._tiles]
        if len(self._tiles) + len(missing) > MAX_TILES:
            raise ValueError(f"the map would get larger than {MAX_TILES} tiles of {TILE * self.step_mm:g} mm")
        for tile in missing:
            self._tiles[tile] = np.zeros((2, TILE * TILE))
        for tile, which, cell in parts:
            sums = self._tiles[tile]
            sums[0] += np.bincount(cell, w[which], TILE * TILE)
            sums[1] += np.bincount(cell, wz[which], TILE * TILE)

    def z_at(self, points_mm: F64) -> F64:
        """The map's z at the nodes nearest to points (N, 3), mm; NaN where it has none."""
        z = np.full(len(points_mm), np.nan)
        for tile, which, cell in _parts(np.rint(points_mm[:, :2] / self.step_mm).astype(np.int64)):
            sums = self._tiles.get(tile)
            if sums is not None:
                with np.errstate(invalid="ignore", divide="ignore"):
                    z[which] = (sums[1] / sums[0])[cell]
        return z

    @property
    def tiles(self) -> int:
        """How many there are; each is 64 KiB."""
        return len(self._tiles)

    def raster(self, least_weight: float = LEAST_WEIGHT) -> Raster:
        """The map's bounding box as one array; a single empty cell while nothing was touched.

        Parameters
        ----------
        least_weight : float
            Cells of less weight are left out.
        """
        if not self._tiles:
            return Raster(np.full((1, 1), np.nan, np.float32), 0.0, 0.0, self.step_mm)
        tops, lefts = zip(*self._tiles, strict=True)
        top, left = min(tops), min(lefts)
        whole = np.zeros((2, (max(tops) - top + 1) * TILE, (max(lefts) - left + 1) * TILE))
        for (i, j), sums in self._tiles.items():
            whole[:, (i - top) * TILE : (i - top + 1) * TILE, (j - left) * TILE : (j - left + 1) * TILE] = sums.reshape(
                2, TILE, TILE
            )
        touched = whole[0] >= least_weight
        rows, cols = (np.flatnonzero(touched.any(axis=axis)) for axis in (1, 0))
        if not rows.size:
            return Raster(np.full((1, 1), np.nan, np.float32), 0.0, 0.0, self.step_mm)
        here = (slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1))
        z = np.full(touched[here].shape, np.nan, np.float32)
        np.divide(whole[1][here], whole[0][here], out=z, where=touched[here], casting="unsafe")
        return Raster(
            z, (left * TILE + int(cols[0])) * self.step_mm, (top * TILE + int(rows[0])) * self.step_mm, self.step_mm
        )


def _parts(node: I64) -> Iterator[tuple[tuple[int, int], Bool, I64]]:
    """For each tile that nodes (column, row) lie in: which they are, and the cell of each in it."""
    col, row = node.T // TILE
    j, i = node.T % TILE
    cell = i * TILE + j
    for one_row in np.unique(row):
        in_row = row == one_row
        for one_col in np.unique(col[in_row]):
            which = in_row & (col == one_col)
            yield (int(one_row), int(one_col)), which, cell[which]
