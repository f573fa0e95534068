"""Find the sensor's pose on the flange and its frames' delay, for which overlapping presses make one surface.

``base_T_sensor = base_T_flange(t - delay) @ flange_T_sensor``. Hand-eye calibration by the surface that presses share,
like iterative closest points (Chen and Medioni, "Object modeling by registration of multiple range images", 1992):
Gauss-Newton with Cauchy's weight. The surface is eliminated, as in `refinement`: first it is one quadratic function of
x and y, which needs no correspondence and so tolerates any error of the start, then the mean heights of cells that
shrink. In the last ones each press has the robot's error and each frame the reconstruction's, and the sensor's
systematic errors of a contact are solved for too, with their typical size as a prior. Contacts that are all tilted
alike look like a turn of the sensor: this tilt is not solved for but considered in the covariance (Schmidt,
"Application of state-space methods to navigation problems", 1966).
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from tacshade_edge.core.stitching.press_points import interpolate
from tacshade_edge.core.stitching.refinement import overlap_cells
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid, of_pose, turn
from tacshade_edge.types import F64, I64, Pose, frozen

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


ORDER = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg", "delay_ms")
"""Order of the covariance: the sensor's origin on the flange, a small turn about the flange's axes through that origin,
and the delay of the frames' time stamps after the robot's poses."""

# Size of the cells, and the deviation of heights at one place; the first is one function for all.
_COARSE_MM = ((0.0, 1.0), (6.0, 0.6), (3.0, 0.4), (1.5, 0.25))
_FINE_MM = (1.0, 0.15)
_ITERATIONS_MAX = 12
_STEP_MAX = np.array((3.0,) * 3 + (np.radians(4),) * 3 + (30.0,))
_CONVERGED = np.array((0.005,) * 3 + (3e-4,) * 3 + (0.1,))
# Standard deviations: of the start; of the sensor's own errors in mm at 10 mm; of the considered ones; of each press
# (its patch's tilt is the reconstruction's, the rest the robot's); of each frame's level and bulge.
_START = np.array((10.0,) * 3 + (np.radians(10),) * 3 + (100.0,))
_OWN_MM = np.array((0.5, 0.5, 1.0))
_CONSIDERED = np.array((0.05, 0.05, 0.02))
_PRESS = np.array((0.2, 0.2, 0.2, np.radians(0.7), np.radians(0.7), np.radians(0.25)))
_FRAME_MM = np.array((0.2, 0.5))
SEEN_MM, SEEN_DEG, SEEN_MS = 2.0, 2.5, 10.0
"""Standard deviation above which a direction was not seen."""
_SPREAD_DEG = 3.0


@frozen
class FoundFlange:
    """The result of `find_flange`: pose, delay, covariance (7, 7) in the order of `ORDER`, and RMS of the height
    differences left.
    """

    flange_T_sensor: Rigid
    delay_ms: float
    covariance: F64
    left_mm: float


def find_flange(frames: Sequence[ContactFrame], start: Rigid, skin_radius_mm: float) -> FoundFlange:
    """Find the sensor's pose on the flange, within 10 mm and 10 degrees of the start, and the delay; frames of a press
    are adjacent. What the presses do not show keeps the start's standard deviation: 10 mm, 10 degrees, 100 ms. Raises
    ConfigError if presses face in opposite directions.
    """
    problem = FlangeProblem(frames, start, skin_radius_mm)
    now = Estimate(
        start, 0.0, np.zeros(len(_OWN_MM)), np.zeros((problem.presses, 6)), np.zeros((len(frames), FRAME_TERMS))
    )
    coarse = np.concatenate((_START, _OWN_MM))
    for level in _COARSE_MM:
        for _ in range(_ITERATIONS_MAX):
            step = _solved(problem.equations(now, *level, joint=False), now, start, coarse)[0]
            now = now.moved(step)
            if (np.abs(step[:7]) < 10 * _CONVERGED).all():
                break
    sigmas = np.concatenate((coarse, np.tile(_PRESS, problem.presses), np.tile(_FRAME_MM, len(frames))))
    for _ in range(_ITERATIONS_MAX):
        equations = problem.equations(now, *_FINE_MM, joint=True)
        step, covariance = _solved(equations, now, start, sigmas)
        now = now.moved(step)
        if (np.abs(step[:7]) < _CONVERGED).all():
            break
    looks_like = covariance[:7] @ equations.considered * _CONSIDERED
    units = np.array((1.0,) * 3 + (np.degrees(1),) * 3 + (1.0,))
    stated = (covariance[:7, :7] + looks_like @ looks_like.T) * np.outer(units, units)
    return FoundFlange(now.flange_T_sensor, now.delay_ms, stated, equations.left_mm)


def _solved(equations: NormalEquations, now: Estimate, start: Rigid, sigmas: F64) -> tuple[F64, F64]:
    """A Gauss-Newton step, limited to `_STEP_MAX`, and the covariance."""
    turned, _ = cv2.Rodrigues(now.flange_T_sensor.rotation @ start.rotation.T)
    moved_mm = now.flange_T_sensor.translation_mm - start.translation_mm
    gone = np.concatenate(
        (moved_mm, turned.ravel(), (now.delay_ms,), now.own, now.presses.ravel(), now.frames_mm.ravel())
    )
    covariance: F64 = np.asarray(np.linalg.inv(equations.matrix + np.diag(sigmas**-2.0)), np.float64)
    step = covariance @ (equations.right - gone[: len(sigmas)] / sigmas**2)
    return step / max(1.0, float(np.max(np.abs(step[:7]) / _STEP_MAX))), covariance


def unseen(frames: Sequence[ContactFrame], start: Rigid, found: FoundFlange) -> str:
    """What cannot be determined, why, and what was expected, as one line; empty if the place on the flange is known.
    The directions are the eigenvectors of the covariance of translation and of rotation, named after the nearest axis
    of the flange.
    """
    blocks = (("translation along", slice(0, 3), SEEN_MM), ("rotation about", slice(3, 6), SEEN_DEG))
    names = []
    for name, block, most in blocks:
        variance, vectors = np.linalg.eigh(found.covariance[block, block])
        axes = sorted({"xyz"[int(k)] for k in np.abs(vectors[:, variance > most**2]).argmax(axis=0)})
        if axes:
            names.append(f"{name} {' and '.join(filter(None, (', '.join(axes[:-1]), axes[-1])))}")
    if not names:
        return ""
    return f"{', '.join(names)} cannot be determined: {_why(frames, start)}"


def delay_seen(found: FoundFlange) -> bool:
    """Whether presses show the delay, which needs motion in contact."""
    k = ORDER.index("delay_ms")
    return bool(found.covariance[k, k] < SEEN_MS**2)


def _why(frames: Sequence[ContactFrame], start: Rigid) -> str:
    turned = [of_pose(frame.track[0]).rotation @ start.rotation for frame in frames]
    yaw_deg, tilt_deg = (
        _spread_deg(np.stack([r[:, 0] for r in turned])),
        _spread_deg(np.stack([r[:, 2] for r in turned])),
    )
    if max(yaw_deg[0], tilt_deg[0]) < _SPREAD_DEG:
        return "every press has the same orientation, expected presses that differ by a yaw of ±90° and a tilt of ±15°"
    if tilt_deg[1] < _SPREAD_DEG:
        about = "no press is tilted" if tilt_deg[0] < _SPREAD_DEG else "all tilts are about one axis"
        return f"{about}, expected tilts of ±15° about two axes"
    return "the presses hardly overlap, or the surface is flat; expected overlapping presses on a wavy surface"


def _spread_deg(directions: F64) -> tuple[float, float]:
    """Standard deviations of unit vectors (N, 3) about their mean in degrees, the larger one first."""
    values = np.linalg.svd(directions - directions.mean(axis=0), compute_uv=False) / np.sqrt(len(directions))
    return float(np.degrees(values[0])), float(np.degrees(values[1])) if len(values) > 1 else 0.0
