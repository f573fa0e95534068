"""Fuse the points of many presses into one map in the base frame, by the robot's poses.

Poses are only as good as the robot, as the map itself shows: if the reconstruction's errors explain
why presses would have to move to agree, the poses are taken as exact; otherwise presses move by the
robot's part (`refinement`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import Rigid
from tacshade_edge.stitching.press_points import PressPoints, height_weight
from tacshade_edge.stitching.refinement import (
    PoseError,
    change,
    correction,
    moved_by_part,
    refine_poses,
    robots_part,
    thin_points,
)
from tacshade_edge.types import F32, F64, I64, frozen

# About the sensor's cells on the skin (0.28 mm at a radius of 20 mm): a coarser step smears walls.
STEP_MM = 0.25
TILE = 64
PRESS_WIDTH_MAX_MM = 200.0  # greatest width of a press of any sensor
# Greatest number of tiles of 64 KiB, 16 mm wide: half a metre square, 64 MiB. A pose that is wrong,
# or a robot that presses all day, must not take the memory of the service.
TILES_MAX = 1024
_POSITION_MAX_MM = 1e6
# Greatest number of tiles in the map's bounding box, a square metre: its raster takes 64 MiB.
EXTENT_MAX_TILES = 4096
BAND_ROWS = 256
# A cell of less weight lies outside the contact.
MIN_WEIGHT = 0.07
_Tile = tuple[int, int]  # row and column
_Box = tuple[slice, slice]


@frozen
class Raster:
    """A map as one array, in the base frame: row i is at y0 + i step, column j at x0 + j step;
    NaN where untouched.
    """

    z_mm: F32
    x0_mm: float
    y0_mm: float
    step_mm: float

    def bands(self) -> Iterator[Raster]:
        """The same raster in bands of `BAND_ROWS`, so
        that processing a large map needs little extra memory.
        """
        for first in range(0, len(self.z_mm), BAND_ROWS):
            y0_mm = self.y0_mm + first * self.step_mm
            yield Raster(self.z_mm[first : first + BAND_ROWS], self.x0_mm, y0_mm, self.step_mm)

    def points(self) -> F64:
        """The touched cells as points (N, 3), mm."""
        i, j = np.nonzero(np.isfinite(self.z_mm))
        return np.stack(
            (self.x0_mm + j * self.step_mm, self.y0_mm + i * self.step_mm, self.z_mm[i, j]), axis=1
        )


@dataclass(frozen=True, slots=True)
class _Window:
    """`rows` x `cols` nodes from (`row`, `col`) on."""

    row: int
    col: int
    rows: int
    cols: int

    def overlaps(self) -> Iterator[tuple[_Tile, _Box, _Box]]:
        """The tiles that the window touches, each with the nodes that both share,
        in the tile and in the window.
        """
        for tile_row, rows_in_tile, rows in _spans(self.row, self.rows):
            for tile_col, cols_in_tile, cols in _spans(self.col, self.cols):
                yield (tile_row, tile_col), (rows_in_tile, cols_in_tile), (rows, cols)


def _spans(first: int, count: int) -> Iterator[tuple[int, slice, slice]]:
    """Tile number, indices in the tile and indices from `first` on, along one axis."""
    for tile in range(first // TILE, (first + count - 1) // TILE + 1):
        start, end = max(first, tile * TILE), min(first + count, (tile + 1) * TILE)
        yield tile, slice(start - tile * TILE, end - tile * TILE), slice(start - first, end - first)


class SurfaceMap:
    """Weighted means of z at the nodes of a grid, each point shared bilinearly by the four nodes
    around it (Curless and Levoy, SIGGRAPH 1996). Nodes without a point stay holes. A bounded map
    refuses by ValueError what would make it too large.
    """

    def __init__(self, step_mm: float = STEP_MM, *, bounded: bool = True) -> None:
        self._bounded = bounded
        self.step_mm = step_mm
        self._tiles: dict[_Tile, F64] = {}  # (weight, weight · z) of TILE x TILE nodes
        self._box: tuple[_Tile, _Tile] | None = None  # the least and greatest row and column

    def add(self, points_mm: F64, weight: F32 | F64) -> None:
        """Fuse points (N, 3) in the base frame with their weights (N,)."""
        if not (np.abs(points_mm) < _POSITION_MAX_MM).all():
            raise ValueError(
                f"a point is not finite, or over {_POSITION_MAX_MM / 1000:g} m from the base"
            )
        if len(points_mm) == 0:
            return
        corner = np.floor(points_mm[:, :2] / self.step_mm)
        along, across = (points_mm[:, :2] / self.step_mm - corner).T
        j, i = corner.T.astype(np.int64)
        window = _window(i, j, self.step_mm)
        shape = (2, window.rows, window.cols)
        cell = (i - window.row) * window.cols + (j - window.col)
        sums = np.zeros((2, window.rows * window.cols))
        for offset, share in (
            (0, (1 - along) * (1 - across)),
            (1, along * (1 - across)),
            (window.cols, (1 - along) * across),
            (window.cols + 1, along * across),
        ):
            w = weight * share
            sums[0] += np.bincount(cell + offset, w, len(sums[0]))
            sums[1] += np.bincount(cell + offset, w * points_mm[:, 2], len(sums[0]))
        sums = sums.reshape(shape)
        overlaps = [each for each in window.overlaps() if sums[0][each[2]].any()]
        # Before anything is added: a press that is refused leaves the map as it was.
        if new := [tile for tile, _, _ in overlaps if tile not in self._tiles]:
            self._box = self._box_with(new)
        for tile, in_tile, in_window in overlaps:
            mine = self._tiles.setdefault(tile, np.zeros((2, TILE, TILE)))
            mine[:, *in_tile] += sums[:, *in_window]

    def _box_with(self, new: Sequence[_Tile]) -> tuple[_Tile, _Tile]:
        """The box of the tiles with new ones. ValueError if a bounded map would become too large.

        From the box so far: looking at all tiles for each press would grow with their square.
        """
        if self._bounded and len(self._tiles) + len(new) > TILES_MAX:
            raise ValueError(
                f"the map would exceed {TILES_MAX} tiles of {TILE * self.step_mm:g} mm"
            )
        rows, cols = zip(*new, *(self._box or ()), strict=True)
        low, high = (min(rows), min(cols)), (max(rows), max(cols))
        if self._bounded and (1 + high[0] - low[0]) * (1 + high[1] - low[1]) > EXTENT_MAX_TILES:
            raise ValueError(
                f"the map would spread over more than {EXTENT_MAX_TILES} tiles of "
                f"{TILE * self.step_mm:g} mm: a pose is far from the others"
            )
        return low, high

    @property
    def tiles(self) -> int:
        """Number of tiles of 64 KiB each."""
        return len(self._tiles)

    def z_at(self, points_mm: F64) -> F32:
        """The z at the nodes nearest to points (N, 3), mm; NaN at holes."""
        if len(points_mm) == 0:
            return np.zeros(0, np.float32)
        j, i = np.rint(points_mm[:, :2].T / self.step_mm).astype(np.int64)
        window = _window(i, j, self.step_mm)
        z_mm = np.full((window.rows, window.cols), np.nan, np.float32)
        for tile, in_tile, in_window in window.overlaps():
            if tile in self._tiles:
                weight, total = self._tiles[tile][:, *in_tile]
                np.divide(total, weight, out=z_mm[in_window], where=weight > 0, casting="unsafe")
        return np.asarray(z_mm[i - window.row, j - window.col])

    def raster(self, min_weight: float = MIN_WEIGHT) -> Raster:
        """The map's bounding box as an array; cells below `min_weight` are holes;
        one empty cell before any contact.
        """
        places = list(zip(*self._tiles, strict=True)) or [(0,), (0,)]
        (top, bottom), (left, right) = ((min(each), max(each)) for each in places)
        whole = np.full(((bottom - top + 1) * TILE, (right - left + 1) * TILE), np.nan, np.float32)
        for (row, col), (weight, total) in self._tiles.items():
            part = whole[(row - top) * TILE :, (col - left) * TILE :][:TILE, :TILE]
            np.divide(total, weight, out=part, where=weight >= min_weight, casting="unsafe")
        known = np.isfinite(whole)
        rows, cols = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return Raster(np.full((1, 1), np.nan, np.float32), 0.0, 0.0, self.step_mm)
        i, j = int(rows[0]), int(cols[0])
        corner_mm = ((left * TILE + j) * self.step_mm, (top * TILE + i) * self.step_mm)
        return Raster(whole[i : rows[-1] + 1, j : cols[-1] + 1], *corner_mm, self.step_mm)


def _window(i: I64, j: I64, step_mm: float) -> _Window:
    """The window from the smallest row and column to one after the greatest."""
    top, left, bottom, right = int(i.min()), int(j.min()), int(i.max()), int(j.max())
    if max(bottom - top, right - left) * step_mm > PRESS_WIDTH_MAX_MM:
        raise ValueError(f"the points of one press are more than {PRESS_WIDTH_MAX_MM:g} mm apart")
    return _Window(top, left, bottom - top + 2, right - left + 2)


# Of all presses together, 16 bytes each: 64 MB. They are kept, since the end places them anew.
POINTS_MAX = 4_000_000
# If poses are not exact, some press makes the outline wrong, so a cell needs more weight.
_MIN_WEIGHT_REFINED = 0.15
# A point at this distance from its cell's mean counts half.
_CAUCHY_MM = 0.2
# Reject a press that is this far off its neighbours after refinement,
# or moved by this many standard deviations.
DEVIATION_MAX_MM = 0.6
CORRECTION_MAX_SIGMAS = 5.0


@dataclass(frozen=True, slots=True)
class PlacedPress:
    """A press in a finished map: its pose, its change at the apex from the reported one,
    why it is left out.
    """

    base_T_sensor: Rigid
    correction_mm: float
    correction_deg: float
    rejected: Reason | None
    points: int


@dataclass(frozen=True, slots=True)
class FinishedMap:
    """A finished map: its raster and presses; RMS of the moves in height that would make presses
    agree (0 if poses were given as exact); whether presses were moved because their poses were not
    taken as exact.
    """

    raster: Raster
    presses: tuple[PlacedPress, ...]
    disagreement_mm: float
    refined: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Press:
    """Points in the sensor frame, their weights in height, the few that refine the pose,
    and the reported pose.
    """

    points_mm: F32
    weight: F32
    thinned: F64
    reported: Rigid


class Stitcher:
    """Collects presses; the map so far is there any time, the refined one at the end.

    `apex_mm`: z of the undeformed skin's middle.
    """

    def __init__(self, apex_mm: float) -> None:
        self._apex = np.array((0.0, 0.0, apex_mm))
        self._presses: list[_Press] = []
        self.points = 0  # of all presses
        self.map = SurfaceMap(STEP_MM)

    @property
    def presses(self) -> int:
        """Number of presses."""
        return len(self._presses)

    @property
    def thinned(self) -> tuple[tuple[F64, Rigid], ...]:
        """Few points of each press (`thin_points`), and its reported pose."""
        return tuple((press.thinned, press.reported) for press in self._presses)

    def add(self, points: PressPoints, base_T_sensor: Rigid) -> None:
        """Add a press at its reported pose.

        ValueError if it has no points or the map is full (`POINTS_MAX`, `TILES_MAX`).
        """
        count = len(points.points_mm)
        if count == 0:
            raise ValueError("a press without points")
        if self.points + count > POINTS_MAX:
            raise ValueError(f"the map would exceed {POINTS_MAX} points")
        # Refinement turns a pose by a degree or so, which hardly changes the slopes.
        weight = height_weight(points, base_T_sensor)
        press = _Press(
            points.points_mm, weight.astype(np.float32), thin_points(points), base_T_sensor
        )
        self.map.add(base_T_sensor.apply(press.points_mm), press.weight)
        self._presses.append(press)
        self.points += count

    def finish(self, error: PoseError | None = PoseError()) -> FinishedMap:  # noqa: B008 (frozen)
        """Find the poses, whose error by the robot is `error` (None: exact), leave out presses that
        do not fit, and fuse again.
        """
        poses, disagreement_mm, part = [p.reported for p in self._presses], 0.0, 0.0
        if error is not None and self.presses > 1:
            thinned = [p.thinned for p in self._presses]
            refined = refine_poses(thinned, poses, self._apex, error)
            dz_mm = [
                change(old, new, self._apex)[2] for old, new in zip(poses, refined, strict=True)
            ]
            disagreement_mm = float(np.sqrt(np.mean(np.square(dz_mm))))
            # The part instead of a threshold in mm: that took exact poses for noisy ones on sensors
            # with larger errors, and refinement then made the map worse.
            part = robots_part(thinned, poses, refined, self._apex)
            if part:
                poses = [
                    moved_by_part(old, new, part, self._apex)
                    for old, new in zip(poses, refined, strict=True)
                ]
        # Three times: to judge each press by the others, without those that do not fit, and with
        # the weight of each point by its distance to the map so far.
        fused = self._fused(poses, [None] * len(poses), None)
        placed = [
            self._placed(press, pose, fused, error if part else None)
            for press, pose in zip(self._presses, poses, strict=True)
        ]
        rejected = [p.rejected for p in placed]
        if any(rejected):
            fused = self._fused(poses, rejected, None)
        raster = self._fused(poses, rejected, fused).raster(
            _MIN_WEIGHT_REFINED if part else MIN_WEIGHT
        )
        return FinishedMap(raster, tuple(placed), disagreement_mm, part > 0)

    def _placed(
        self, press: _Press, pose: Rigid, fused: SurfaceMap, error: PoseError | None
    ) -> PlacedPress:
        at = pose.apply(press.thinned[:, :3])
        deviation_mm = float(np.median(np.abs(at[:, 2] - fused.z_at(at))))
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

    def _fused(
        self, poses: Sequence[Rigid], rejected: Sequence[Reason | None], before: SurfaceMap | None
    ) -> SurfaceMap:
        """Fuse the presses into a new map, with Cauchy's weight of each point's distance
        to the map `before`.
        """
        # Each press was within bounds when it came; refined, it lies slightly elsewhere, and a map
        # must not fail at its end.
        fused = SurfaceMap(STEP_MM, bounded=False)
        for press, pose, reason in zip(self._presses, poses, rejected, strict=True):
            if reason is not None:
                continue
            at, weight = pose.apply(press.points_mm), press.weight
            if before is not None:
                weight = np.nan_to_num(
                    weight / (1 + ((at[:, 2] - before.z_at(at)) / _CAUCHY_MM) ** 2)
                )
            fused.add(at, weight)
        return fused
