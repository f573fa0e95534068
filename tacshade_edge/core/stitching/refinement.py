"""Poses refined on overlaps: where two presses touched the same place, they have to agree on its height.

All poses are solved for at once. The unknown surface is eliminated: of a cell of the base frame only the differences
between the presses in it count. Each press is held where the robot reported it, with the robot's error as the weight;
as those errors are independent, their mean over many presses holds the map, and it cannot bend.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.stitching.press_points import Touch
from tacshade_edge.rigid import Rigid, turn
from tacshade_edge.types import F64, I64

CELL_MM = 0.7
MOST_POINTS = 150  # of a press: it has six numbers to find
ROUNDS = 8
SURFACE_SIGMA_MM = 0.1
"""How far the heights of one place, as two presses see them, differ with exact poses."""
_ROBUST_MM = 0.15  # a difference that size counts half
_SAME_MM = 0.005  # the rounds end when no press moves farther
_CG_STEPS = 60
_CG_TOLERANCE = 0.01  # of one round; the next one goes on
_STEEP = 2.0  # mm per mm; beyond, a slope between two cells is a step


@dataclass(frozen=True, slots=True)
class PoseError:
    """Standard deviation of what the robot reports: in each axis, and about each axis through the apex."""

    position_mm: float = 0.3
    rotation_deg: float = 0.6


def thinned(touch: Touch) -> F64:
    """One point for each small square (`CELL_MM`) that a press touched, `MOST_POINTS` at most.

    Returns
    -------
    float64 (N, 4)
        x, y, z of the means in mm, and their weights up to 1.
    """
    points = touch.points_mm.astype(np.float64)
    cell = np.floor(points[:, :2] / CELL_MM).astype(np.int64)
    _, index = np.unique(cell[:, 0] * 100_003 + cell[:, 1], return_inverse=True)
    weight = np.bincount(index, touch.trust)
    means = [np.bincount(index, touch.trust * points[:, k]) / weight for k in range(3)]
    # Errors of neighbouring points go together: more of them do not say more.
    full = (CELL_MM / 0.3) ** 2
    thin = np.stack((*means, np.minimum(weight / full, 1.0)), axis=1)
    return thin[:: -(-len(thin) // MOST_POINTS) or 1]


def refined(presses: Sequence[F64], reported: Sequence[Rigid], centre_mm: F64, error: PoseError) -> list[Rigid]:
    """Find the poses at which the presses agree best.

    Parameters
    ----------
    presses : sequence of float64 (N, 4)
        `thinned` points of each press, in the sensor frame.
    reported : sequence of Rigid
        ``base_T_sensor``, as the robot said.
    centre_mm : float64 (3,)
        In the sensor frame: what errors of rotation turn about, the undeformed apex.
    error : PoseError

    Returns
    -------
    list of Rigid
        ``base_T_sensor``. A press that overlaps no other stays where it was.
    """
    if len(presses) < 2:
        return list(reported)
    owner = np.repeat(np.arange(len(presses)), [len(p) for p in presses])
    points = np.concatenate(presses)
    prior: F64 = np.asarray(np.repeat((error.position_mm, np.radians(error.rotation_deg)), 3) ** -2.0, np.float64)
    moved = np.zeros((len(presses), 6))  # translation in mm, rotation vector in rad, of each from its reported pose
    poses = list(reported)
    for _ in range(ROUNDS):
        step = _step(points, owner, poses, centre_mm, moved, prior)
        moved += step
        poses = [_corrected(pose, m, centre_mm) for pose, m in zip(reported, moved, strict=True)]
        if np.abs(step[:, :3]).max() < _SAME_MM:
            break
    return poses


def correction(reported: Rigid, now: Rigid, centre_mm: F64) -> tuple[float, float]:
    """How far a press was moved: mm at its apex, and degrees."""
    shift_mm = float(np.linalg.norm(now.apply(centre_mm) - reported.apply(centre_mm)))
    cosine = (np.trace(reported.rotation.T @ now.rotation) - 1) / 2
    return shift_mm, float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _corrected(pose: Rigid, moved: F64, centre_mm: F64) -> Rigid:
    """A pose turned about its apex in the base's axes, and shifted."""
    apex = pose.apply(centre_mm)
    turned = turn(moved[3:]).rotation
    return Rigid(turned @ pose.rotation, turned @ (pose.translation_mm - apex) + apex + moved[:3])


def _step(points: F64, owner: I64, poses: Sequence[Rigid], centre_mm: F64, moved: F64, prior: F64) -> F64:
    """One Gauss-Newton step of all poses: (P, 6)."""
    rotations, shifts = (np.stack([getattr(p, name) for p in poses]) for name in ("rotation", "translation_mm"))
    at = np.einsum("nij,nj->ni", rotations[owner], points[:, :3]) + shifts[owner]
    lever = at - (np.stack([p.apply(centre_mm) for p in poses]))[owner]
    cell, cells, slope, offset = _surface(at, points[:, 3])
    # The height that this point gives to its cell's middle, and how it changes with translation and rotation.
    height = at[:, 2] - np.sum(slope * offset, axis=1)
    normal = np.concatenate((-slope, np.ones((len(at), 1))), axis=1)
    jacobian = np.concatenate((normal, np.cross(lever, normal)), axis=1)
    mean = _cell_means(height, points[:, 3], cell, cells)
    weight = points[:, 3] / (SURFACE_SIGMA_MM**2 * (1 + ((height - mean[cell]) / _ROBUST_MM) ** 2))
    total = np.bincount(cell, weight, cells)

    def reduced(values: F64) -> F64:
        """Take each cell's mean away."""
        return np.asarray(values - (np.bincount(cell, weight * values, cells) / total)[cell])

    starts = np.searchsorted(owner, np.arange(len(poses)))

    def gathered(values: F64) -> F64:
        return np.asarray(np.add.reduceat(jacobian * (weight * values)[:, None], starts, axis=0))

    def times(step: F64) -> F64:
        return gathered(reduced(np.einsum("nk,nk->n", jacobian, step[owner]))) + prior * step

    blocks = np.empty((len(poses), 6, 6))
    for k in range(6):
        blocks[:, :, k] = gathered(jacobian[:, k])
    blocks += np.diag(prior)
    right = -gathered(reduced(height)) - prior * moved
    return _conjugate_gradients(times, right, np.asarray(np.linalg.inv(blocks), np.float64))


def _surface(at: F64, weight: F64) -> tuple[I64, int, F64, F64]:
    """The cell of each point, how many there are, the map's slope there (N, 2), and x, y from the cell's middle."""
    column_row = np.floor(at[:, :2] / CELL_MM).astype(np.int64)
    offset = at[:, :2] - (column_row + 0.5) * CELL_MM
    column_row -= column_row.min(axis=0)
    width = int(column_row[:, 0].max()) + 3  # a free column between rows, so that neighbours need no checks
    key = (column_row[:, 1] + 1) * width + column_row[:, 0] + 1
    used, cell = np.unique(key, return_inverse=True)
    z = _cell_means(at[:, 2], weight, cell, len(used))
    slope = np.stack([_slope(used, z, step) for step in (1, width)], axis=1)
    return cell, len(used), slope[cell], offset


def _slope(used: I64, z: F64, step: int) -> F64:
    """Of the cells' heights towards the neighbour `step` on: of two sides, one or none; mm per mm."""

    def neighbour(by: int) -> F64:
        at = np.minimum(np.searchsorted(used, used + by), len(used) - 1)
        return np.where(used[at] == used + by, z[at], np.nan)

    sides = np.stack((neighbour(step) - z, z - neighbour(-step))) / CELL_MM
    known = np.isfinite(sides)
    mean = np.where(known, sides, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.asarray(np.clip(mean, -_STEEP, _STEEP))


def _cell_means(values: F64, weight: F64, cell: I64, cells: int) -> F64:
    return np.asarray(np.bincount(cell, weight * values, cells) / np.bincount(cell, weight, cells))


def _conjugate_gradients(times: Callable[[F64], F64], right: F64, inverse: F64) -> F64:
    """Solve with 6 x 6 blocks as the preconditioner."""
    x = np.zeros_like(right)
    residual = right.copy()
    z = np.einsum("pij,pj->pi", inverse, residual)
    direction = z
    rho = start = float(np.sum(residual * z))
    for _ in range(_CG_STEPS):
        if rho <= _CG_TOLERANCE**2 * start or rho == 0:
            break
        image = times(direction)
        alpha = rho / float(np.sum(direction * image))
        x += alpha * direction
        residual -= alpha * image
        z = np.einsum("pij,pj->pi", inverse, residual)
        rho, before = float(np.sum(residual * z)), rho
        direction = z + (rho / before) * direction
    return x
