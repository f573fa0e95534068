"""Find the sensor's pose on the flange and its frames' delay,
for which overlapping presses make one surface.

``base_T_sensor = base_T_flange(t - delay) @ flange_T_sensor``, by Gauss-Newton with Cauchy's
weight. First the surface is one quadratic function of x and y, which needs no correspondence and so
tolerates any error of the start, then the mean heights of cells that shrink. In the last ones each
press has the robot's error and each frame the reconstruction's, and the sensor's systematic errors
of a contact are solved for too. Contacts that are all tilted alike look like a turn of the sensor:
this tilt is only considered in the covariance (Schmidt, 1966).
"""

from __future__ import annotations

import bisect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid, of_pose, turn
from tacshade_edge.robot.pose_buffer import interpolate
from tacshade_edge.stitching.refinement import overlap_cells
from tacshade_edge.types import F64, I64, Pose, frozen

ORDER = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg", "delay_ms")
"""Order of the covariance: the sensor's origin on the flange, a small turn about the flange's axes
through that origin, and the delay of the frames' time stamps after the robot's poses.
"""
# Standard deviation above which a direction was not seen.
SEEN_MM, SEEN_DEG, SEEN_MS = (
    2.0,
    2.5,
    10.0,
)

# Size of the cells (0: one quadratic function for all), and the deviation of heights at one place.
# From coarse to fine: at 10 mm and 10 degrees off, small cells would pair the wrong points.
_COARSE_MM = ((0.0, 1.0), (6.0, 0.6), (3.0, 0.4), (1.5, 0.25))
_FINE_MM = (1.0, 0.15)
_ITERATIONS_MAX = 12
_STEP_MAX = np.array((3.0,) * 3 + (np.radians(4),) * 3 + (30.0,))
_CONVERGED = np.array((0.005,) * 3 + (3e-4,) * 3 + (0.1,))
# Standard deviations: of the start; of the sensor's own errors, a contact's level along x, along y
# and outwards, in mm at 10 mm from the axis; of each press (its patch's tilt is the
# reconstruction's, the rest the robot's); of each frame's level and bulge; of what is considered, a
# common tilt of all contacts about two axes, and of distances.
_START = (10.0,) * 3 + (np.radians(10),) * 3 + (100.0,)
_OWN_MM = (0.5, 0.5, 1.0)
_PRESS = (0.2, 0.2, 0.2, np.radians(0.7), np.radians(0.7), np.radians(0.25))
_FRAME_MM = (0.2, 0.5)
_CONSIDERED = (0.05, 0.05, 0.02)
_SENSOR, _COMMON = len(_START), len(_START) + len(_OWN_MM)
_LATERAL_RATIO = 2.0
_CAUCHY_SIGMAS = 1.5
_QUADRATIC_MM = 10.0
_FACING_MIN = 0.5
# Relative to the weights: a few points in one place do not define a quadratic function.
_RIDGE = 1e-9
# Of numeric derivatives, in mm, rad and ms: one function places the points, and no formula of its
# derivatives can disagree with it.
_DIFFERENCE = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class ContactFrame:
    """One frame in contact: `refinement.thin_points` (N, 4); the number of its press, from 0, never
    decreasing (frames of one share the robot's error); its time; ``base_T_flange`` around it, in
    order, a single one if the robot stood still.
    """

    points: F64
    press: int
    t_ns: int
    track: tuple[Pose, ...]


@frozen
class FoundFlange:
    """Pose, delay, covariance (7, 7) in the order of `ORDER`,
    and RMS of the height differences left.
    """

    flange_T_sensor: Rigid
    delay_ms: float
    covariance: F64
    left_mm: float


def find_flange(frames: Sequence[ContactFrame], start: Rigid, apex_mm: float) -> FoundFlange:
    """Find the sensor's pose on the flange, within 10 mm and 10 degrees of the start, and the
    delay. What the presses do not show keeps the start's standard deviation.

    Raises ConfigError if presses face in opposite directions.
    """
    problem = _Problem(frames, start, apex_mm)
    x = np.zeros(len(problem.sigmas))
    for level, joint in (*((level, False) for level in _COARSE_MM), (_FINE_MM, True)):
        for _ in range(_ITERATIONS_MAX):
            step, covariance, left_mm = problem.step(x, *level, joint=joint)
            x = x + step
            if (np.abs(step[:_SENSOR]) < _CONVERGED * (1 if joint else 10)).all():
                break
    units = np.array((1.0,) * 3 + (np.degrees(1),) * 3 + (1.0,))
    return FoundFlange(problem.sensor(x), float(x[6]), covariance * np.outer(units, units), left_mm)


class _Problem:
    """All points of all frames, and where the unknowns place them.

    The unknowns x, with standard deviations `sigmas`: the sensor's translation in mm and turn in
    rad about the flange's axes, from the start; delay in ms; the sensor's own errors; of each press
    a shift in mm in the upright axes, and a turn about the apex in rad; of each frame its height in
    mm, everywhere and at 10 mm from the contact's middle; what is only considered. The upward
    direction is against the sensor's mean axis at the start.
    """

    def __init__(self, frames: Sequence[ContactFrame], start: Rigid, apex_mm: float) -> None:
        self._frames, self._start = frames, start
        self._presses = 1 + max(frame.press for frame in frames)
        self._apex = np.array((0.0, 0.0, apex_mm))
        self._frame_of: I64 = np.repeat(
            np.arange(len(frames)), [len(frame.points) for frame in frames]
        )
        self._press_of_frame: I64 = np.array([frame.press for frame in frames])
        points = np.concatenate([frame.points for frame in frames])
        self._points, self._weight = points[:, :3], points[:, 3]
        outwards = self._points / np.linalg.norm(self._points, axis=1, keepdims=True)
        middles = np.stack(
            [
                np.average(frame.points[:, :2], axis=0, weights=frame.points[:, 3])
                for frame in frames
            ]
        )
        middle, beside = (
            middles[self._frame_of] / 10,
            (self._points[:, :2] - middles[self._frame_of]) / 10,
        )
        self._bulge = np.column_stack((np.ones(len(points)), np.sum(beside**2, axis=1)))
        along_rays = np.column_stack((middle, np.sum(middle**2, axis=1), beside))
        # Shift (N, 3) of each point by 1 of each of the sensor's own errors and
        # of the considered ones.
        self._shapes = [outwards * each[:, None] for each in along_rays.T] + [
            self._points * (1, 1, 0)
        ]
        self.sigmas = np.concatenate(
            (
                _START,
                _OWN_MM,
                np.tile(_PRESS, self._presses),
                np.tile(_FRAME_MM, len(frames)),
                _CONSIDERED,
            )
        )
        axes = np.stack(
            [of_pose(frame.track[0]).rotation @ start.rotation[:, 2] for frame in frames]
        )
        if np.linalg.norm(axes.mean(axis=0)) < _FACING_MIN:
            raise ConfigError(
                "found presses that face in opposite directions, expected presses on one surface"
            )
        self._upright = _upright(-axes.mean(axis=0))

    def sensor(self, x: F64) -> Rigid:
        """``flange_T_sensor``."""
        return Rigid(
            turn(x[3:6]).rotation @ self._start.rotation, self._start.translation_mm + x[:3]
        )

    def step(
        self, x: F64, cell_mm: float, sigma_mm: float, *, joint: bool
    ) -> tuple[F64, F64, float]:
        """A Gauss-Newton step of x, limited to `_STEP_MAX`, covariance (7, 7) and RMS of the
        differences in mm, for heights of deviation `sigma_mm` at one place; `joint` gives presses
        and frames their own errors.
        """
        # Here, as a daemon imports this module through `map_files`: SciPy would cost it 23 MiB.
        from scipy import sparse
        from scipy.sparse.linalg import splu

        poses = self._poses(x[6])
        at = self._placed(x, poses)
        basis, slope, height_mm = _surface(at, self._weight, cell_mm)
        weight = self._weight / (sigma_mm**2 * (1 + _LATERAL_RATIO**2 * np.sum(slope**2, axis=1)))
        left_mm = height_mm - basis @ _fitted(basis, weight, height_mm)
        weight = weight / (1 + (left_mm / (_CAUCHY_SIGMAS * sigma_mm)) ** 2)

        def change(which: int | slice) -> F64:
            """Derivative of the heights by unknowns of which each point has one."""
            moved = x.copy()
            moved[which] += _DIFFERENCE
            by = self._placed(moved, self._poses(moved[6]) if which == _SENSOR - 1 else poses) - at
            return np.asarray((by[:, 2] - np.sum(slope * by[:, :2], axis=1)) / _DIFFERENCE)

        free = len(x) - len(_CONSIDERED) if joint else _COMMON
        columns = sparse.csr_array(sparse.hstack([-basis, *self._columns(change, joint=joint)]))
        weighted = columns.T @ sparse.diags_array(weight)
        surface = basis.shape[1]
        prior = np.concatenate(
            (np.full(surface, _RIDGE * weight.sum()), self.sigmas[:free] ** -2.0)
        )
        right = -(weighted @ left_mm) - prior * np.concatenate((np.zeros(surface), x[:free]))
        of_sensor = np.eye(len(prior), _SENSOR, -surface)
        solved = splu(sparse.csc_array(weighted @ columns + sparse.diags_array(prior))).solve(
            np.column_stack((right, of_sensor))
        )
        step = np.zeros(len(x))
        step[:free] = solved[surface:, 0]
        # Limited: far from the solution the surfaces of two presses may not overlap at all.
        step /= max(1.0, float(np.max(np.abs(step[:_SENSOR]) / _STEP_MAX)))
        considered = np.column_stack(
            [change(len(x) - k) * _CONSIDERED[-k] for k in range(len(_CONSIDERED), 0, -1)]
        )
        # Schmidt: what is considered is not solved for, but widens the covariance by what it would
        # have been taken for.
        looks_like = solved[:, 1:].T @ (weighted @ considered)
        covariance = solved[surface : surface + _SENSOR, 1:] + looks_like @ looks_like.T
        return step, covariance, float(np.sqrt(np.average(left_mm**2, weights=weight)))

    def _columns(self, change: Callable[[int | slice], F64], *, joint: bool) -> list[Any]:
        """Derivatives of the heights by all that is solved for, in the order of x."""
        parts: list[Any] = [np.column_stack([change(k) for k in range(_COMMON)])]
        if joint:
            # A point depends on its own press and frame alone, so six derivatives serve all
            # presses.
            end = _COMMON + 6 * self._presses
            moves = np.column_stack([change(slice(_COMMON + k, end, 6)) for k in range(6)])
            parts.append(_blocks(moves, self._press_of_frame[self._frame_of], self._presses))
            parts.append(_blocks(self._bulge, self._frame_of, len(self._frames)))
        return parts

    def _poses(self, delay_ms: float) -> tuple[F64, F64]:
        """``base_T_flange`` of each frame in the upright axes:
        rotation (F, 3, 3), translation (F, 3).
        """
        poses = [of_pose(_flange_at(frame, delay_ms)) for frame in self._frames]
        rotation = self._upright @ np.stack([pose.rotation for pose in poses])
        return rotation, np.stack([pose.translation_mm for pose in poses]) @ self._upright.T

    def _placed(self, x: F64, poses: tuple[F64, F64]) -> F64:
        """The points (N, 3) in the upright axes."""
        of, (rotation, origin_mm), sensor = self._frame_of, poses, self.sensor(x)
        presses = x[_COMMON : _COMMON + 6 * self._presses].reshape(-1, 6)
        frames_mm = x[_COMMON + presses.size : len(x) - len(_CONSIDERED)].reshape(-1, 2)
        own = np.concatenate((x[_SENSOR:_COMMON], x[len(x) - len(_CONSIDERED) :]))
        points = self._points + sum(
            error * shape for error, shape in zip(own, self._shapes, strict=True) if error
        )
        turns = np.stack([turn(press[3:]).rotation for press in presses])[self._press_of_frame]
        apex = rotation @ sensor.apply(self._apex) + origin_mm + presses[self._press_of_frame, :3]
        at = (
            np.einsum("nij,nj->ni", (turns @ rotation @ sensor.rotation)[of], points - self._apex)
            + apex[of]
        )
        at[:, 2] += np.sum(self._bulge * frames_mm[of], axis=1)
        return np.asarray(at)


def _surface(at: F64, weight: F64, cell_mm: float) -> tuple[Any, F64, F64]:
    """A surface that is linear in its unknowns: their sparse columns (N, M),
    the slope and the height at the points.
    """
    from scipy import sparse

    if cell_mm:
        cells = overlap_cells(at, weight, cell_mm)
        ones = (np.ones(len(at)), (np.arange(len(at)), cells.of_point))
        return sparse.csr_array(ones, shape=(len(at), cells.count)), cells.slope, cells.height_mm
    x, y = ((at[:, :2] - at[:, :2].mean(axis=0)) / _QUADRATIC_MM).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    basis = sparse.csr_array(np.stack((one, x, y, x * x, x * y, y * y), axis=1))
    by_x, by_y = (
        np.stack((zero, one, zero, 2 * x, y, zero)),
        np.stack((zero, zero, one, zero, x, 2 * y)),
    )
    fitted = _fitted(basis, weight, at[:, 2])
    slope = np.column_stack((fitted @ by_x, fitted @ by_y)) / _QUADRATIC_MM
    return basis, slope, at[:, 2]


def _fitted(basis: Any, weight: F64, height_mm: F64) -> F64:
    """The surface's unknowns that fit the heights best."""
    from scipy import sparse
    from scipy.sparse.linalg import spsolve

    weighted = basis.T @ sparse.diags_array(weight)
    ridge = sparse.diags_array(np.full(basis.shape[1], _RIDGE * weight.sum()))
    return np.asarray(spsolve(sparse.csc_array(weighted @ basis + ridge), weighted @ height_mm))


def _blocks(columns: F64, of: I64, count: int) -> Any:
    """Sparse (N, count · C): each point has its columns in the block of its press or frame."""
    from scipy import sparse

    points, width = columns.shape
    at = (of[:, None] * width + np.arange(width)).ravel()
    return sparse.csr_array(
        (columns.ravel(), at, np.arange(points + 1) * width), shape=(points, count * width)
    )


def _upright(up: F64) -> F64:
    """A rotation (3, 3) that turns a direction to z."""
    z = up / np.linalg.norm(up)
    y = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    y /= np.linalg.norm(y)
    return np.stack((np.cross(y, z), y, z))


def _flange_at(frame: ContactFrame, delay_ms: float) -> Pose:
    track = frame.track
    if len(track) == 1:
        return track[0]
    t_ns = frame.t_ns - round(delay_ms * 1e6)
    after = min(max(bisect.bisect_left(track, t_ns, key=lambda pose: pose.t_ns), 1), len(track) - 1)
    return interpolate(track[after - 1], track[after], t_ns)


def unseen(found: FoundFlange) -> str:
    """The flange's axes along and about which the place cannot be determined,
    and what was expected, as one line.
    """
    sigma = np.sqrt(np.diag(found.covariance))
    names = [
        f"{motion} {', '.join(axes)}"
        for motion, first, most in (
            ("translation along", 0, SEEN_MM),
            ("rotation about", 3, SEEN_DEG),
        )
        if (
            axes := [
                axis
                for axis, one in zip("xyz", sigma[first : first + 3], strict=True)
                if one > most
            ]
        )
    ]
    expected = (
        "overlapping presses on a wavy surface, with yaws of ±90° and tilts of ±15° about two axes"
    )
    return f"{'; '.join(names)} cannot be determined, expected {expected}" if names else ""


def delay_seen(found: FoundFlange) -> bool:
    """Whether presses show the delay, which needs motion in contact."""
    return bool(found.covariance[6, 6] < SEEN_MS**2)
