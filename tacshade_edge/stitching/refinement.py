"""Refine poses on overlaps: two presses that touched the same place must agree on its height.

Bundle adjustment of heights: Gauss-Newton solves for all poses at once; the unknown surface is
eliminated (the Schur complement), and Cauchy's weight reduces outliers. Each press has a prior at
the pose that the robot reported; the robot's errors are independent, so their mean over many
presses holds the map and keeps it from bending.

The reconstruction's errors move presses too: a depth that is a tenth too small looks like a pose
that is too high. The part of these errors that poses can explain grows with the part that they
cannot, so the differences left after refinement show the size of the former (`robots_part`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.rigid import Rigid, turn, turned_rad
from tacshade_edge.stitching.press_points import PressPoints
from tacshade_edge.types import F64, I64

_SLOPE_MAX = 2.0  # mm per mm; a steeper slope between two cells is a step
CELL_MM = 0.7
# Of each press, which has six unknowns.
POINTS_MAX = 150
ITERATIONS_MAX = 8
SURFACE_SIGMA_MM = 0.1  # standard deviation of a place's heights between presses with exact poses
_CAUCHY_MM = 0.15  # a difference of this size counts half
_CONVERGED_MM = 0.005  # ends when no press moves farther in an iteration
# Of one Gauss-Newton step: what is left over, the next step continues.
_CG_ITERATIONS_MAX, _CG_TOLERANCE = 60, 0.01
LATERAL_RATIO = 5.0  # lateral over height error of a point
# Ratio of the moves in height from the reconstruction's errors alone to the differences that they
# leave: typical and greatest. With exact poses it is 1.1 to 2.5.
_OWN_MOVES_TYPICAL, _OWN_MOVES_MAX = 1.8, 2.8


@dataclass(frozen=True, slots=True, eq=False)
class OverlapCells:
    """Points in cells: the cell of each, from 0; the number of cells with a point; the slope (N, 2)
    of the points' mean surface in each point's cell; z that each point gives to the middle of its
    cell, with the slope removed.
    """

    of_point: I64
    count: int
    slope: F64
    height_mm: F64


def overlap_cells(at: F64, weight: F64, cell_mm: float) -> OverlapCells:
    """Sort points (N, 3) in the base frame, with weights (N,), into cells."""
    column_row = np.floor(at[:, :2] / cell_mm).astype(np.int64)
    offset = at[:, :2] - (column_row + 0.5) * cell_mm
    column_row -= column_row.min(axis=0)
    # A free column between rows, so that neighbours need no checks.
    width = int(column_row[:, 0].max()) + 3
    key = (column_row[:, 1] + 1) * width + column_row[:, 0] + 1
    used, cell = np.unique(key, return_inverse=True)
    z = _means(at[:, 2], weight, cell)
    slope = np.stack([_slope(used, z, step, cell_mm) for step in (1, width)], axis=1)[cell]
    return OverlapCells(cell, len(used), slope, at[:, 2] - np.sum(slope * offset, axis=1))


def _slope(used: I64, z: F64, step: int, cell_mm: float) -> F64:
    """Slope of the cells' heights towards the neighbour at `step`, from both sides, one or none;
    mm per mm.
    """

    def neighbour(by: int) -> F64:
        at = np.minimum(np.searchsorted(used, used + by), len(used) - 1)
        return np.where(used[at] == used + by, z[at], np.nan)

    sides = np.stack((neighbour(step) - z, z - neighbour(-step))) / cell_mm
    known = np.isfinite(sides)
    mean = np.where(known, sides, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.asarray(np.clip(mean, -_SLOPE_MAX, _SLOPE_MAX))


def _means(values: F64, weight: F64, cell: I64) -> F64:
    return np.asarray(np.bincount(cell, weight * values) / np.bincount(cell, weight))


@dataclass(frozen=True, slots=True)
class PoseError:
    """Standard deviations of the robot's reported poses:
    along each axis, and about each axis through the apex.
    """

    position_mm: float = 0.3
    rotation_deg: float = 0.6


def thin_points(press: PressPoints) -> F64:
    """Reduce a press to the mean of each small square (`CELL_MM`), at most `POINTS_MAX`: (N, 4), x,
    y, z in mm, and weights up to 1.
    """
    points = press.points_mm.astype(np.float64)
    cell = np.floor(points[:, :2] / CELL_MM).astype(np.int64)
    # One number for each cell: more columns than a press can have.
    _, index = np.unique(cell[:, 0] * 100_003 + cell[:, 1], return_inverse=True)
    weight = np.bincount(index, press.confidence)
    means = [np.bincount(index, press.confidence * points[:, k]) / weight for k in range(3)]
    # Errors of neighbouring points are correlated, so more points add no information.
    full = (CELL_MM / 0.3) ** 2
    thin = np.stack((*means, np.minimum(weight / full, 1.0)), axis=1)
    return thin[:: -(-len(thin) // POINTS_MAX) or 1]


def refine_poses(
    presses: Sequence[F64], reported: Sequence[Rigid], centre_mm: F64, error: PoseError
) -> list[Rigid]:
    """Find ``base_T_sensor`` at which the presses (`thin_points`) agree best; a press that overlaps
    no other keeps the reported one. Rotation errors turn about `centre_mm`, the undeformed apex.
    """
    if len(presses) <= 1:
        return list(reported)
    press_of, points = _joined(presses)
    prior: F64 = np.asarray(
        np.repeat((error.position_mm, np.radians(error.rotation_deg)), 3) ** -2.0, np.float64
    )
    # Translation in mm, rotation vector in rad, from the reported pose.
    corrections = np.zeros((len(presses), 6))
    poses = list(reported)
    for _ in range(ITERATIONS_MAX):
        step = _step(points, press_of, poses, centre_mm, corrections, prior)
        corrections += step
        poses = [
            _corrected(pose, c, centre_mm) for pose, c in zip(reported, corrections, strict=True)
        ]
        if np.abs(step[:, :3]).max() < _CONVERGED_MM:
            break
    return poses


def robots_part(
    presses: Sequence[F64], reported: Sequence[Rigid], refined: Sequence[Rigid], centre_mm: F64
) -> float:
    """Estimate the part (0 to below 1) of the refined poses' moves that corrects the robot's
    errors: the variance of the moves in height, less the typical share of the reconstruction's own
    errors, over the whole; 0 if those may explain all of it.
    """
    press_of, points = _joined(presses)
    cells = overlap_cells(_placed(points, press_of, refined, centre_mm)[0], points[:, 3], CELL_MM)
    cell, height = cells.of_point, cells.height_mm
    weight = points[:, 3] / (1 + LATERAL_RATIO**2 * np.sum(cells.slope**2, axis=1))
    shared = np.bincount(cell)[cell] > 1
    if not shared.any():
        return 0.0
    # Of the cell's mean, which follows the point by this part.
    own_part = weight / np.bincount(cell, weight)[cell]
    squares = (height - _means(height, weight, cell)[cell]) ** 2 / np.maximum(1 - own_part, 0.05)
    left2 = float(np.sum((weight * squares)[shared]) / np.sum(weight[shared]))
    moves = [change(reported[k], refined[k], centre_mm)[2] for k in np.unique(press_of[shared])]
    moved2 = float(np.mean(np.square(moves)))
    if moved2 <= _OWN_MOVES_MAX**2 * left2:
        return 0.0
    return 1 - _OWN_MOVES_TYPICAL**2 * left2 / moved2


def change(reported: Rigid, refined: Rigid, centre_mm: F64) -> F64:
    """The way from a reported to the refined pose, (6,):
    translation in mm at the apex, rotation vector in rad.
    """
    translation_mm = refined.apply(centre_mm) - reported.apply(centre_mm)
    return np.concatenate((translation_mm, turned_rad(refined.rotation @ reported.rotation.T)))


def moved_by_part(reported: Rigid, refined: Rigid, part: float, centre_mm: F64) -> Rigid:
    """The pose at a part, 0 to 1, of the way from the reported to the refined one."""
    return _corrected(reported, part * change(reported, refined, centre_mm), centre_mm)


def correction(reported: Rigid, refined: Rigid, centre_mm: F64) -> tuple[float, float]:
    """Size of the `change`: translation in mm, rotation in degrees."""
    way = change(reported, refined, centre_mm)
    return float(np.linalg.norm(way[:3])), float(np.degrees(np.linalg.norm(way[3:])))


def _corrected(pose: Rigid, correction: F64, centre_mm: F64) -> Rigid:
    """Turn a pose about its apex in the base's axes, and shift it."""
    apex = pose.apply(centre_mm)
    rotation = turn(correction[3:]).rotation
    return Rigid(
        rotation @ pose.rotation, rotation @ (pose.translation_mm - apex) + apex + correction[:3]
    )


def _step(
    points: F64, press_of: I64, poses: Sequence[Rigid], centre_mm: F64, corrections: F64, prior: F64
) -> F64:
    """One Gauss-Newton step of all poses: (P, 6)."""
    at, lever = _placed(points, press_of, poses, centre_mm)
    cells = overlap_cells(at, points[:, 3], CELL_MM)
    cell, height = cells.of_point, cells.height_mm
    # Change of the height that a point gives to its cell's middle with translation and rotation.
    normal = np.concatenate((-cells.slope, np.ones((len(at), 1))), axis=1)
    jacobian = np.concatenate((normal, np.cross(lever, normal)), axis=1)
    mean = _means(height, points[:, 3], cell)
    weight = points[:, 3] / (SURFACE_SIGMA_MM**2 * (1 + ((height - mean[cell]) / _CAUCHY_MM) ** 2))
    total = np.bincount(cell, weight)

    def eliminated(values: F64) -> F64:
        """Subtract each cell's mean, which eliminates the surface."""
        return np.asarray(values - (np.bincount(cell, weight * values) / total)[cell])

    # Points stand in the order of their presses, so that sums over a press are sums over a slice.
    starts = np.searchsorted(press_of, np.arange(len(poses)))

    def to_presses(values: F64) -> F64:
        """Jᵀ W, summed over each press."""
        return np.asarray(np.add.reduceat(jacobian * (weight * values)[:, None], starts, axis=0))

    def normal_matrix(step: F64) -> F64:
        """The reduced normal equations' matrix times `step`."""
        return (
            to_presses(eliminated(np.einsum("nk,nk->n", jacobian, step[press_of]))) + prior * step
        )

    # The preconditioner: each press alone, as if the surface were known.
    blocks = np.empty((len(poses), 6, 6))
    for k in range(6):
        blocks[:, :, k] = to_presses(jacobian[:, k])
    blocks += np.diag(prior)
    right = -to_presses(eliminated(height)) - prior * corrections
    return _conjugate_gradients(normal_matrix, right, np.asarray(np.linalg.inv(blocks), np.float64))


def _joined(presses: Sequence[F64]) -> tuple[I64, F64]:
    """The press of each point, and all points."""
    return np.repeat(np.arange(len(presses)), [len(p) for p in presses]), np.concatenate(presses)


def _placed(points: F64, press_of: I64, poses: Sequence[Rigid], centre_mm: F64) -> tuple[F64, F64]:
    """Points in the base frame, and relative to the apex of their press."""
    rotations, shifts = (
        np.stack([getattr(p, name) for p in poses]) for name in ("rotation", "translation_mm")
    )
    at = np.einsum("nij,nj->ni", rotations[press_of], points[:, :3]) + shifts[press_of]
    return at, at - (np.stack([p.apply(centre_mm) for p in poses]))[press_of]


def _conjugate_gradients(matrix: Callable[[F64], F64], right: F64, inverse: F64) -> F64:
    """Solve by conjugate gradients (Hestenes and Stiefel 1952),
    with the blocks' `inverse` as preconditioner.
    """
    # Not SciPy's `cg`: its import takes 1.2 s of a stop's 1.4 s and 23 MiB of the service's 150,
    # for poses that agree within 0.07 mm and 0.2 degrees and are found no sooner.
    x = np.zeros_like(right)
    residual = right.copy()
    z = np.einsum("pij,pj->pi", inverse, residual)
    direction = z
    rho = start = float(np.sum(residual * z))
    for _ in range(_CG_ITERATIONS_MAX):
        if rho <= _CG_TOLERANCE**2 * start or rho == 0:
            break
        image = matrix(direction)
        alpha = rho / float(np.sum(direction * image))
        x += alpha * direction
        residual -= alpha * image
        z = np.einsum("pij,pj->pi", inverse, residual)
        rho, before = float(np.sum(residual * z)), rho
        direction = z + (rho / before) * direction
    return x
