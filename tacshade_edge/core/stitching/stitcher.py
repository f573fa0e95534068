"""Fuse the points of many presses into one map in the base frame, by the robot's poses.

Poses are only as good as the robot, as the map itself shows: if the reconstruction's errors explain why presses would
have to move to agree, the poses are taken as exact; otherwise presses move by the robot's part (`refinement`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.stitching.press_points import PressPoints, height_weight
from tacshade_edge.core.stitching.refinement import (
    PoseError,
    correction,
    moved_by_part,
    refine_poses,
    robots_part,
    thin_points,
)
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F32, F64, I64, frozen

STEP_MM = 0.25
"""About the size of the sensor's cells on the skin (0.28 mm at a radius of 20 mm): a coarser step smears walls."""
TILE = 64
PRESS_WIDTH_MAX_MM = 200.0
"""Greatest width of a press of any sensor."""
TILES_MAX = 1024
"""Greatest number of tiles of 64 KiB, 16 mm wide: half a metre square, 64 MiB."""
_POSITION_MAX_MM = 1e6
EXTENT_MAX_TILES = 4096
"""Greatest number of tiles in the map's bounding box, a square metre: its raster takes 64 MiB."""
BAND_ROWS = 256
MIN_WEIGHT = 0.07
"""A cell of less weight lies outside the contact."""


@frozen
class Raster:
    """A map as one array, in the base frame: row i is at y0 + i step, column j at x0 + j step; NaN where no press
    touched.
    """

    z_mm: F32
    x0_mm: float
    y0_mm: float
    step_mm: float

    def bands(self) -> Iterator[Raster]:
        """The same raster in bands of `BAND_ROWS`, so that processing a large map needs little extra memory."""
        for first in range(0, len(self.z_mm), BAND_ROWS):
            y0_mm = self.y0_mm + first * self.step_mm
            yield Raster(self.z_mm[first : first + BAND_ROWS], self.x0_mm, y0_mm, self.step_mm)

    def points(self) -> F64:
        """The touched cells as points (N, 3), mm."""
        i, j = np.nonzero(np.isfinite(self.z_mm))
        return np.stack((self.x0_mm + j * self.step_mm, self.y0_mm + i * self.step_mm, self.z_mm[i, j]), axis=1)


@dataclass(frozen=True, slots=True)
class _Overlap:
    """The nodes that a window and a tile share: their rows and columns in the tile and in the window."""

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
        """The overlap with each tile that the window touches."""
        for tile_row, rows_in_tile, rows in _spans(self.row, self.rows):
            for tile_col, cols_in_tile, cols in _spans(self.col, self.cols):
                yield _Overlap((tile_row, tile_col), (rows_in_tile, cols_in_tile), (rows, cols))


def _spans(first: int, count: int) -> Iterator[tuple[int, slice, slice]]:
    """Tile number, indices in the tile and indices from `first` on, along one axis."""
    for tile in range(first // TILE, (first + count - 1) // TILE + 1):
        start, end = max(first, tile * TILE), min(first + count, (tile + 1) * TILE)
        yield tile, slice(start - tile * TILE, end - tile * TILE), slice(start - first, end - first)


@dataclass(frozen=True, slots=True, eq=False)
class Heights:
    """The z of a map's nodes, in a quarter of the map's memory: tiles (TILE, TILE) by their place, NaN at holes."""

    tiles: dict[tuple[int, int], F32]
    step_mm: float

    def z_at(self, points_mm: F64) -> F32:
        """The z at the nodes nearest to points (N, 3), mm; NaN at holes."""
        if len(points_mm) == 0:
            return np.zeros(0, np.float32)
        j, i = np.rint(points_mm[:, :2].T / self.step_mm).astype(np.int64)
        window = _window(i, j, self.step_mm)
        z_mm = np.full((window.rows, window.cols), np.nan, np.float32)
        for overlap in window.overlaps():
            if overlap.tile in self.tiles:
                z_mm[overlap.in_window] = self.tiles[overlap.tile][overlap.in_tile]
        z: F32 = z_mm[i - window.row, j - window.col]
        return z


class SurfaceMap:
    """Weighted means of z at the nodes of a grid, each point shared bilinearly by the four nodes around it.

    The map keeps running sums of weight and weight · z, as in Curless and Levoy, "A volumetric method for building
    complex models from range images", SIGGRAPH 1996. Nodes without a point stay holes. `add` raises ValueError, and
    adds nothing, if a point is not finite, points lie more than `PRESS_WIDTH_MAX_MM` apart, or the map would get more
    than `TILES_MAX` tiles or spread over more than `EXTENT_MAX_TILES`; it does not bound points that were already in a
    bounded map.
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
        window = _window(i, j, self.step_mm)
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
            raise ValueError(f"the map would exceed {TILES_MAX} tiles of {TILE * self.step_mm:g} mm")
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

    @property
    def tiles(self) -> int:
        """Number of tiles of 64 KiB each."""
        return len(self._tiles)

    def heights(self) -> Heights:
        """The present heights, without the weights."""
        tiles = {}
        for at, (weight, total) in self._tiles.items():
            tiles[at] = np.full((TILE, TILE), np.nan, np.float32)
            np.divide(total, weight, out=tiles[at], where=weight > 0, casting="unsafe")
        return Heights(tiles, self.step_mm)

    def raster(self, min_weight: float = MIN_WEIGHT) -> Raster:
        """The map's bounding box as one array, with cells below `min_weight` as holes; one empty cell before the first
        contact.
        """
        known = {at: weight >= min_weight for at, (weight, _) in self._tiles.items()}
        known = {at: cells for at, cells in known.items() if cells.any()}
        if not known:
            return Raster(np.full((1, 1), np.nan, np.float32), 0.0, 0.0, self.step_mm)
        spans = [(i * TILE + np.flatnonzero(cells.any(axis=1))[[0, -1]]) for (i, _), cells in known.items()]
        top, bottom = min(int(first) for first, _ in spans), max(int(last) for _, last in spans)
        spans = [(j * TILE + np.flatnonzero(cells.any(axis=0))[[0, -1]]) for (_, j), cells in known.items()]
        left, right = min(int(first) for first, _ in spans), max(int(last) for _, last in spans)
        window = _Window(top, left, bottom - top + 1, right - left + 1)
        whole = np.full((window.rows, window.cols), np.nan, np.float32)
        for overlap in window.overlaps():
            if overlap.tile in known:
                weight, total = self._tiles[overlap.tile][:, *overlap.in_tile]
                where = known[overlap.tile][overlap.in_tile]
                np.divide(total, weight, out=whole[overlap.in_window], where=where, casting="unsafe")
        return Raster(whole, left * self.step_mm, top * self.step_mm, self.step_mm)


def _window(i: I64, j: I64, step_mm: float) -> _Window:
    """The window from the smallest row and column to one after the greatest."""
    top, left, bottom, right = int(i.min()), int(j.min()), int(i.max()), int(j.max())
    if max(bottom - top, right - left) * step_mm > PRESS_WIDTH_MAX_MM:
        raise ValueError(f"the points of one press are more than {PRESS_WIDTH_MAX_MM:g} mm apart")
    return _Window(top, left, bottom - top + 2, right - left + 2)


def _box(tiles: list[tuple[int, int]], before: tuple[int, int, int, int] | None) -> tuple[int, int, int, int]:
    """First and last row and column of tiles, merged with an earlier box."""
    rows, cols = [row for row, _ in tiles], [col for _, col in tiles]
    if before is not None:
        rows += before[::2]
        cols += before[1::2]
    return min(rows), min(cols), max(rows), max(cols)


POINTS_MAX = 4_000_000
"""Limit for all presses together: 16 bytes each, 64 MB."""
# If poses are not exact, some press makes the outline wrong, so a cell needs more weight.
_MIN_WEIGHT_REFINED = 0.15
_CAUCHY_MM = 0.2  # a point at this distance from its cell's mean counts half
# Reject a press that is this far off its neighbours after refinement, or moved by this many standard deviations.
DEVIATION_MAX_MM = 0.6
CORRECTION_MAX_SIGMAS = 5.0


@dataclass(frozen=True, slots=True)
class PlacedPress:
    """One press in a finished map: the pose found, or the reported one if poses are exact; the change from the reported
    one at the apex; why its points are not in the map, if they are not; their number.
    """

    base_T_sensor: Rigid
    correction_mm: float
    correction_deg: float
    rejected: Reason | None
    points: int


@dataclass(frozen=True, slots=True)
class StitchedMap:
    """A finished map: its raster and presses; RMS of the moves in height that would make presses agree (0 if poses were
    given as exact); whether presses were moved because their poses were not taken as exact.
    """

    raster: Raster
    presses: tuple[PlacedPress, ...]
    disagreement_mm: float
    refined: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Press:
    """Points in the sensor frame, their weights in height, the few that refine the pose, and the reported pose."""

    points_mm: F32
    weight: F32
    thinned: F64
    reported: Rigid

    def at(self, base_T_sensor: Rigid) -> F64:
        return base_T_sensor.apply(self.points_mm)


class Stitcher:
    """Collects presses; the map so far is available at any time, the refined one at the end. `apex_mm` is the skin's
    radius.
    """

    def __init__(self, apex_mm: float) -> None:
        self._apex = np.array((0.0, 0.0, apex_mm))
        self._presses: list[_Press] = []
        self._points = 0
        self.map = SurfaceMap(STEP_MM)

    @property
    def presses(self) -> int:
        """Number of presses."""
        return len(self._presses)

    @property
    def points(self) -> int:
        """Number of points of all presses."""
        return self._points

    def add(self, points: PressPoints, base_T_sensor: Rigid) -> None:
        """Add a press at its reported pose; the cost does not grow with the map. Raises ValueError, and adds nothing,
        if the press has no points or the map is full (`POINTS_MAX`, `TILES_MAX`).
        """
        count = len(points.points_mm)
        if count == 0:
            raise ValueError("a press without points")
        if self._points + count > POINTS_MAX:
            raise ValueError(f"the map would exceed {POINTS_MAX} points")
        # Refinement turns a pose by a degree or so, which hardly changes the slopes.
        weight = height_weight(points, base_T_sensor)
        press = _Press(points.points_mm, weight.astype(np.float32), thin_points(points), base_T_sensor)
        self.map.add(press.at(base_T_sensor), press.weight)
        self._presses.append(press)
        self._points += count

    def finish(self, error: PoseError | None = PoseError()) -> StitchedMap:  # noqa: B008 (frozen)
        """Find the poses, whose error by the robot is `error` (None: they are exact), leave out presses that do not
        fit, and fuse again without outlying points.
        """
        reported, disagreement_mm = [p.reported for p in self._presses], 0.0
        poses, part = reported, 0.0
        if error is not None and self.presses > 1:
            thinned = [p.thinned for p in self._presses]
            refined = refine_poses(thinned, reported, self._apex, error)
            dz_mm = [(p.apply(self._apex) - r.apply(self._apex))[2] for p, r in zip(refined, reported, strict=True)]
            disagreement_mm = float(np.sqrt(np.mean(np.square(dz_mm))))
            part = robots_part(thinned, reported, refined, self._apex)
        exact = part == 0
        if exact:
            error = None
        else:
            poses = [moved_by_part(r, p, part, self._apex) for r, p in zip(reported, refined, strict=True)]
        heights = self._fused(poses, [None] * len(poses), None).heights()
        placed = [self._placed(press, pose, heights, error) for press, pose in zip(self._presses, poses, strict=True)]
        rejected = [p.rejected for p in placed]
        if any(rejected):
            heights = self._fused(poses, rejected, None).heights()
        fused = self._fused(poses, rejected, heights)
        raster = fused.raster(MIN_WEIGHT if exact else _MIN_WEIGHT_REFINED)
        return StitchedMap(raster, tuple(placed), disagreement_mm, not exact)

    def _placed(self, press: _Press, pose: Rigid, heights: Heights, error: PoseError | None) -> PlacedPress:
        at = pose.apply(press.thinned[:, :3])
        deviation_mm = float(np.median(np.abs(at[:, 2] - heights.z_at(at))))
        correction_mm, correction_deg = correction(press.reported, pose, self._apex)
        rejected = None
        if deviation_mm > DEVIATION_MAX_MM:
            text = f"the press deviates from the other presses by {deviation_mm:.2f} mm"
            rejected = Reason(ReasonCode.PRESS_DEVIATES, text)
        elif error is not None and correction_mm > CORRECTION_MAX_SIGMAS * error.position_mm:
            text = f"refinement would have to move the press by {correction_mm:.2f} mm"
            rejected = Reason(ReasonCode.PRESS_DISPLACED, text)
        elif error is not None and correction_deg > CORRECTION_MAX_SIGMAS * error.rotation_deg:
            text = f"refinement would have to turn the press by {correction_deg:.1f} degrees"
            rejected = Reason(ReasonCode.PRESS_DISPLACED, text)
        return PlacedPress(pose, correction_mm, correction_deg, rejected, len(press.points_mm))

    def _fused(self, poses: Sequence[Rigid], rejected: Sequence[Reason | None], before: Heights | None) -> SurfaceMap:
        """Fuse the presses into a new map, with Cauchy's weight of each point's distance to the map `before`."""
        fused = SurfaceMap(STEP_MM, bounded=False)  # refined presses lie slightly elsewhere
        for press, pose, reason in zip(self._presses, poses, rejected, strict=True):
            if reason is not None:
                continue
            at, weight = press.at(pose), press.weight
            if before is not None:
                weight = np.nan_to_num(weight / (1 + ((at[:, 2] - before.z_at(at)) / _CAUCHY_MM) ** 2))
            fused.add(at, weight)
        return fused
