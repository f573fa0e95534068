"""Find the sensor's pose on the flange and its frames' delay, for which overlapping presses make one surface.

Hand-eye calibration by the surface that presses share, like iterative closest points (Chen and Medioni, "Object
modeling by registration of multiple range images", 1992): at each place of the base frame the heights of all presses
must agree. Gauss-Newton with Cauchy's weight, coarse to fine: the surface is first one quadratic function, which needs
no correspondence and so tolerates any error of the start, then cells that shrink. In the last ones each press has the
robot's error and each frame the reconstruction's, and the sensor's systematic errors of a contact are solved for too,
with their typical size as a prior. Contacts that are all tilted alike look like a turn of the sensor: this tilt is not
solved for but considered in the covariance (Schmidt, "Application of state-space methods to navigation problems",
1966).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from tacshade_edge.core.stitching.flange_equations import (
    FRAME_TERMS,
    ContactFrame,
    Estimate,
    FlangeProblem,
    NormalEquations,
)
from tacshade_edge.rigid import Rigid, of_pose
from tacshade_edge.types import F64, frozen

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
