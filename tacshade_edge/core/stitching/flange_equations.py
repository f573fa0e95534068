"""Place the points of frames in contact on one surface, and set up the normal equations of the unknowns.

``base_T_sensor = base_T_flange(t - delay) @ flange_T_sensor``. The unknown surface is eliminated, as in `refinement`:
first it is one quadratic function of x and y, then the mean heights of cells.
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from tacshade_edge.core.stitching.poses import interpolate
from tacshade_edge.core.stitching.refinement import overlap_cells
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid, of_pose, turn
from tacshade_edge.types import F64, I64, Pose

OWN_TERMS = 3
"""Number of the sensor's own errors: change of a contact's level along x, along y, and outwards."""
GLOBALS = 7 + OWN_TERMS
FRAME_TERMS = 2
"""Number of each frame's own errors: its level and its bulge."""
CONSIDERED = 3
"""Number of errors not solved for: a common tilt of all contacts about x or y, and of distance from the axis."""
_LATERAL_RATIO = 2.0
_CAUCHY_SIGMAS = 1.5
_QUADRATIC_MM = 10.0
_FACING_MIN = 0.5
_RIDGE = 1e-9  # relative to the weights: a few points in one place do not define a quadratic function


@dataclass(frozen=True, slots=True, eq=False)
class ContactFrame:
    """One frame in contact: `refinement.thin_points` (N, 4) in the sensor frame; the number of its press, from 0, never
    decreasing (frames of one share the robot's error); its time; ``base_T_flange`` around it, in order, a single one if
    the robot stood still.
    """

    points: F64
    press: int
    t_ns: int
    track: tuple[Pose, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The unknowns: the sensor's own errors (OWN_TERMS,) in mm at 10 mm from the axis; of each press (presses, 6) mm in
    the upright axes, and a turn about the apex in rad; of each frame (frames, FRAME_TERMS) mm in height, everywhere and
    at 10 mm from the contact's middle.
    """

    flange_T_sensor: Rigid
    delay_ms: float
    own: F64
    presses: F64
    frames_mm: F64

    def moved(self, step: F64) -> Estimate:
        """The estimate after a solver step: x, y, z, turn about the flange's axes, delay, and the rest in order."""
        sensor = self.flange_T_sensor
        turned = Rigid(turn(step[3:6]).rotation @ sensor.rotation, sensor.translation_mm + step[:3])
        presses, frames_mm = self.presses, self.frames_mm
        if len(step) > GLOBALS:
            rest = step[GLOBALS:]
            presses = presses + rest[: presses.size].reshape(presses.shape)
            frames_mm = frames_mm + rest[presses.size :].reshape(frames_mm.shape)
        return Estimate(turned, self.delay_ms + float(step[6]), self.own + step[7:GLOBALS], presses, frames_mm)


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Normal equations (K, K), (K,) of the weighted residuals, without the surface and without priors; the part (K,
    CONSIDERED) of each considered error that looks like the unknowns; RMS of the remaining differences.
    """

    matrix: F64
    right: F64
    considered: F64
    left_mm: float


class FlangeProblem:
    """All points of all frames, ready to place. The start defines the upward direction, against the sensor's mean axis,
    in any base frame; ConfigError if presses face in opposite directions.
    """

    def __init__(self, frames: Sequence[ContactFrame], start: Rigid, skin_radius_mm: float) -> None:
        self.frames = frames
        self.presses = 1 + max(frame.press for frame in frames)
        self._apex = np.array((0.0, 0.0, skin_radius_mm))
        counts = [len(frame.points) for frame in frames]
        self._frame_of: I64 = np.repeat(np.arange(len(frames)), counts)
        self._press_of: I64 = np.array([frame.press for frame in frames])[self._frame_of]
        points = np.concatenate([frame.points for frame in frames])
        self._points, self._weight = points[:, :3], points[:, 3]
        self._outwards = self._points / np.linalg.norm(self._points, axis=1, keepdims=True)
        self._own = _own_shapes(frames)
        beside2 = np.sum(self._own[:, OWN_TERMS:] ** 2, axis=1)
        self._of_frame = np.column_stack((np.ones(len(beside2)), beside2))
        axes = np.stack([of_pose(frame.track[0]).rotation @ start.rotation[:, 2] for frame in frames])
        if np.linalg.norm(axes.mean(axis=0)) < _FACING_MIN:
            raise ConfigError("found presses that face in opposite directions, expected presses on one surface")
        self._upright = _upright(-axes.mean(axis=0))

    def equations(self, now: Estimate, cell_mm: float, sigma_mm: float, *, joint: bool) -> NormalEquations:
        """Linearise about an estimate, for heights of deviation `sigma_mm` at one place; `cell_mm` 0 takes the surface
        as one quadratic function, `joint` gives presses and frames their own errors.
        """
        from scipy import sparse  # a daemon does not need it

        placed = self._placed(now)
        surface = _surface(placed.at, self._weight, cell_mm)
        normal = np.concatenate((-surface.slope, np.ones((len(placed.at), 1))), axis=1)
        steep2 = np.sum(surface.slope**2, axis=1)
        weight = self._weight / (sigma_mm**2 * (1 + _LATERAL_RATIO**2 * steep2))
        weight = weight / (1 + (surface.left_mm(weight) / (_CAUCHY_SIGMAS * sigma_mm)) ** 2)
        in_flange = np.einsum("nji,nj->ni", placed.base_R_flange, normal)
        in_sensor = in_flange @ now.flange_T_sensor.rotation
        own = np.sum(in_sensor * self._outwards, axis=1)[:, None] * self._own
        velocity = np.sum(normal * placed.per_ms, axis=1)[:, None]
        jacobian = sparse.csr_array(
            np.hstack((in_flange, np.cross(placed.arm, in_flange), velocity, own[:, :OWN_TERMS]))
        )
        if joint:
            moves = np.hstack((normal, np.cross(placed.lever, normal)))
            jacobian = sparse.hstack(
                (
                    jacobian,
                    _blocks(moves, self._press_of, self.presses),
                    _blocks(self._of_frame, self._frame_of, len(self.frames)),
                )
            )
        outwards_mm = np.sum(in_sensor[:, :2] * self._points[:, :2], axis=1)
        unknowns = jacobian.shape[1]
        all_columns = sparse.hstack(
            (jacobian, np.column_stack((own[:, OWN_TERMS:], outwards_mm, surface.height_mm))), format="csr"
        )
        weighted = sparse.dia_array((weight[None], [0]), shape=(len(weight),) * 2) @ all_columns
        shares = (surface.basis.T @ weighted).tocsr()
        product = (jacobian.T @ weighted).toarray() - (
            shares[:, :unknowns].T @ surface.solved(weight, shares)
        ).toarray()
        left_mm = float(np.sqrt(np.average(surface.left_mm(weight) ** 2, weights=weight)))
        return NormalEquations(product[:, :unknowns], -product[:, -1], product[:, unknowns:-1], left_mm)

    def _placed(self, now: Estimate) -> _Placed:
        poses = [_flange_at(frame, now.delay_ms) for frame in self.frames]
        rotation, origin, speed, turning = (
            np.stack([self._upright @ getattr(pose, name) for pose in poses])
            for name in ("rotation", "origin_mm", "mm_per_ms", "rad_per_ms")
        )
        of, sensor = self._frame_of, now.flange_T_sensor
        points = self._points + self._outwards * (self._own[:, :OWN_TERMS] @ now.own)[:, None]
        arm = points @ sensor.rotation.T
        from_flange = np.einsum("nij,nj->ni", rotation[of], arm + sensor.translation_mm)
        apex = (np.einsum("tij,j->ti", rotation, sensor.apply(self._apex)) + origin)[of]
        turns = np.stack([turn(press[3:]).rotation for press in now.presses])[self._press_of]
        lever = np.einsum("nij,nj->ni", turns, from_flange + origin[of] - apex)
        at = apex + lever + now.presses[self._press_of, :3]
        at[:, 2] += np.sum(self._of_frame * now.frames_mm[of], axis=1)
        return _Placed(at, lever, rotation[of], arm, -(speed[of] + np.cross(turning[of], from_flange)))


@dataclass(frozen=True, slots=True, eq=False)
class _Placed:
    """The placed points (N, 3): place in the upright axes, and relative to the apex of its press; ``base_R_flange``;
    relative to the sensor's origin, in the flange's axes; movement with the delay.
    """

    at: F64
    lever: F64
    base_R_flange: F64
    arm: F64
    per_ms: F64


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """A surface that is linear in its unknowns: their columns, and the slope and height at the points."""

    basis: Any  # sparse (N, M)
    cells: bool  # each point has one 1
    slope: F64
    height_mm: F64

    def solved(self, weight: F64, right: Any) -> Any:
        """Solve (BᵀWB) X = a sparse matrix (M, K)."""
        from scipy import sparse

        if self.cells:
            return sparse.dia_array((1 / (self.basis.T @ weight)[None], [0]), shape=(self.basis.shape[1],) * 2) @ right
        return sparse.csr_array(np.linalg.solve(_weighted_square(self.basis.toarray(), weight), right.toarray()))

    def left_mm(self, weight: F64) -> F64:
        """Distance of each point from the best surface in height, mm."""
        from scipy import sparse

        right = sparse.csr_array((self.basis.T @ (weight * self.height_mm))[:, None])
        return np.asarray(self.height_mm - (self.basis @ self.solved(weight, right)).toarray()[:, 0])


def _surface(at: F64, weight: F64, cell_mm: float) -> _Surface:
    from scipy import sparse

    if cell_mm:
        cells = overlap_cells(at, weight, cell_mm)
        ones = (np.ones(len(at)), (np.arange(len(at)), cells.of_point))
        return _Surface(sparse.csr_array(ones, shape=(len(at), cells.count)), True, cells.slope, cells.height_mm)
    x, y = ((at[:, :2] - at[:, :2].mean(axis=0)) / _QUADRATIC_MM).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    basis = np.stack((one, x, y, x * x, x * y, y * y), axis=1)
    c = np.linalg.solve(_weighted_square(basis, weight), basis.T @ (weight * at[:, 2]))
    slopes = (
        np.stack((zero, one, zero, 2 * x, y, zero), axis=1) @ c,
        np.stack((zero, zero, one, zero, x, 2 * y), axis=1) @ c,
    )
    return _Surface(sparse.csr_array(basis), False, np.stack(slopes, axis=1) / _QUADRATIC_MM, at[:, 2])


def _weighted_square(columns: F64, weight: F64) -> F64:
    return np.asarray(columns.T @ (weight[:, None] * columns) + _RIDGE * weight.sum() * np.eye(columns.shape[1]))


def _own_shapes(frames: Sequence[ContactFrame]) -> F64:
    """Shift of each point outwards along its ray by 1 mm of each of the sensor's own errors; (N, OWN_TERMS + 2)."""
    parts = []
    for frame in frames:
        x, y = frame.points[:, :2].T / 10
        mx, my = np.average(frame.points[:, :2], axis=0, weights=frame.points[:, 3]) / 10
        level = np.broadcast_to((mx, my, mx * mx + my * my), (len(x), 3))
        parts.append(np.column_stack((level, x - mx, y - my)))
    return np.concatenate(parts)


def _blocks(columns: F64, of: I64, count: int) -> Any:
    """Sparse (N, count · C): each point has its columns in the block of its press or frame."""
    from scipy import sparse

    points, width = columns.shape
    at = (of[:, None] * width + np.arange(width)).ravel()
    return sparse.csr_array((columns.ravel(), at, np.arange(points + 1) * width), shape=(points, count * width))


def _upright(up: F64) -> F64:
    """A rotation (3, 3) that turns a direction to z."""
    z = up / np.linalg.norm(up)
    y = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    y /= np.linalg.norm(y)
    return np.stack((np.cross(y, z), y, z))


@dataclass(frozen=True, slots=True, eq=False)
class _Moving:
    """Pose and velocity of the flange."""

    rotation: F64
    origin_mm: F64
    mm_per_ms: F64
    rad_per_ms: F64


def _flange_at(frame: ContactFrame, delay_ms: float) -> _Moving:
    track = frame.track
    if len(track) == 1:
        still = of_pose(track[0])
        return _Moving(still.rotation, still.translation_mm, np.zeros(3), np.zeros(3))
    t_ns = frame.t_ns - round(delay_ms * 1e6)
    after = min(max(bisect.bisect_left(track, t_ns, key=lambda pose: pose.t_ns), 1), len(track) - 1)
    a, b = track[after - 1], track[after]
    now, before, then = of_pose(interpolate(a, b, t_ns)), of_pose(a), of_pose(b)
    ms = (b.t_ns - a.t_ns) / 1e6
    turned, _ = cv2.Rodrigues(then.rotation @ before.rotation.T)
    return _Moving(
        now.rotation, now.translation_mm, (then.translation_mm - before.translation_mm) / ms, turned.ravel() / ms
    )
