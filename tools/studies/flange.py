"""How well `stitch --find-flange` finds the sensor on the flange and the delay of its frames, on simulated presses.

::

    .venv/bin/python -m tools.studies.flange [--trials 20] [--profile accurate] [--final]

Each trial has a surface, a calibrated sensor, a true place on the flange, a delay, and a start that is 10 mm and 10
degrees off. A robot that believes the start follows the plan of docs/how-to/stitching.md: it turns and moves where the
plan says, then down until the sensor is deep enough in the surface. Every fifth press has frames of the motion down and
up. The reported poses have Gaussian noise, drawn once for each press.
"""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.stitching.flange import ContactFrame, FoundFlange, find_flange
from tacshade_edge.core.stitching.press_points import press_points
from tacshade_edge.core.stitching.refinement import thin_points
from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.simulator import pad as pads
from tacshade_edge.simulator.press import Press, Shape
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.studies.evaluate.work import calibrated, reconstructor
from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import F64, U8, Calibration, Frame, Pose
from tools.testbed import flange_plan
from tools.testbed.simulator.families import sensor_name

SENSORS = ("default", "5", "11", "other:1", "two-scales:3")
FINAL = ("9021", "9022", "9023", "other:9021", "two-scales:9021")
NOISES = ((0.1, 0.1), (0.2, 0.2), (0.3, 0.3))
"""Standard deviations of the reported poses: mm in every axis, degrees about a random axis through the apex."""
START_MM, START_DEG = 10.0, 10.0
TRUE = shift(12, -7, 55) @ turn((0.3, -0.2, 1.1))
DEPTH_MM, VARIED_MM = 2.0, 0.4
MOVING_MM = (-1.2, -0.6, 0.6, 1.2)  # above the press: on the way down, then up
DELAY_MS, DELAY_S = (-40.0, 60.0), 0.035
"""Range of a trial's delay, and that of a recording."""
WITHIN_MM, WITHIN_DEG, WITHIN_MS, WITHIN_SIGMAS = 0.5, 0.7, 5.0, 2.5
_SIDE_MM = 36.0
_PRESS_NOISE = 700_000
_PERIOD_S, _TAKES_S = 0.05, 3.0
_SPAN = round((flange_plan.PAUSE_S / 2 + flange_plan.LIFT_MM / flange_plan.SPEED_MM_S) / _PERIOD_S)


@dataclass(frozen=True, slots=True)
class Relief:
    """A smooth square: a sum of waves (amplitude in mm, wave numbers along x and y in rad per mm, phase)."""

    waves: tuple[tuple[float, float, float, float], ...]
    width_mm: float = _SIDE_MM
    length_mm: float = _SIDE_MM

    @property
    def top_mm(self) -> float:
        """The z of the highest point in mm."""
        axis = np.linspace(0, _SIDE_MM, 73)
        return float(self.height_mm(*np.meshgrid(axis, axis)).max())

    def height_mm(self, x: F64, y: F64) -> F64:
        """The surface's z in mm at points of the plane."""
        return np.asarray(sum(a * np.sin(kx * x + ky * y + phase) for a, kx, ky, phase in self.waves))

    def under(self, base_T_sensor: Rigid, skin_radius_mm: float) -> Shape:
        """The shape that a sensor at a pose meets, like `Pad.under`."""
        apex = np.array((0.0, 0.0, skin_radius_mm))
        # A height over the surface is at most this many times the distance to it.
        steepest = math.hypot(1, sum(abs(a) * math.hypot(kx, ky) for a, kx, ky, _ in self.waves))

        def sdf(points: F64) -> F64:
            at = base_T_sensor.apply(points + apex)
            return ((at[:, 2] - self.height_mm(at[:, 0], at[:, 1])) / steepest).astype(points.dtype)

        return Shape("relief", sdf)


def relief(seed: int) -> Relief:
    """Waves of 12 to 40 mm, together about 2 mm high."""
    rng = np.random.default_rng((seed, 13))
    waves = []
    for _ in range(4):
        number, angle = 2 * math.pi / rng.uniform(12, 40), rng.uniform(0, math.pi)
        amplitude, phase = rng.uniform(0.2, 0.5), rng.uniform(0, 2 * math.pi)
        waves.append((float(amplitude), number * math.cos(angle), number * math.sin(angle), float(phase)))
    return Relief(tuple(waves))


SURFACES: tuple[Callable[[], pads.Surface], ...] = (
    *(functools.partial(relief, seed) for seed in (1, 2, 3)),
    pads.touchpad,
)


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """Reconstructed frames: each one's thinned points, true pose, press, and distance above that press."""

    points: list[F64]
    base_T_sensor: list[Rigid]
    press: list[int]
    above_mm: list[float]
    radius_mm: float


def start_of(trial: int) -> Rigid:
    """The pose that the robot believes."""
    rng = np.random.default_rng((trial, 31))
    axis, way = rng.standard_normal(3), rng.standard_normal(3)
    rotation = turn(axis / np.linalg.norm(axis) * math.radians(START_DEG)).rotation @ TRUE.rotation
    return Rigid(rotation, TRUE.translation_mm + way / np.linalg.norm(way) * START_MM)


@functools.cache
def _calibration(sensor: str) -> Calibration:
    return calibrated(sensor_name(sensor), 8, 40).calibration


def lowered(pose: Rigid, radius_mm: float, surface: pads.Surface, depth_mm: float) -> Rigid:
    """Lower a pose along the base's z until the undeformed skin is `depth_mm` deep in the surface."""
    dx, dy = np.meshgrid(*(np.linspace(-0.8, 0.8, 81) * radius_mm,) * 2)
    dome = np.sqrt(np.maximum(radius_mm**2 - dx**2 - dy**2, 0))
    inside = dome > 0.6 * radius_mm
    x, y, z = pose.translation_mm
    reaches = surface.height_mm(x + dx[inside], y + dy[inside]) + dome[inside]
    return shift(0, 0, float(reaches.max() - depth_mm - z)) @ pose


def taken(trial: int, sensor_text: str, profile: str) -> Taken:
    """All frames of the plan in contact."""
    sensor, calibration = sensor_name(sensor_text).make(), _calibration(sensor_text)
    radius_mm, made = sensor.model.skin_radius_mm, reconstructor(calibration, profile)
    surface = SURFACES[trial // len(SENSORS) % len(SURFACES)]()
    rng = np.random.default_rng((trial, 32))
    out = Taken([], [], [], [], radius_mm)
    for k, pose in enumerate(flange_plan.plan(surface.width_mm / 2, surface.length_mm / 2, radius_mm)):
        true = pose @ start_of(trial).inverse() @ TRUE
        true = lowered(true, radius_mm, surface, DEPTH_MM + float(rng.uniform(-VARIED_MM, VARIED_MM)))
        for above_mm in (0.0, *(MOVING_MM if k % 5 == k // 5 % 5 else ())):
            at, seq = shift(0, 0, abs(above_mm)) @ true, len(out.press)
            press = Press(surface.under(at, radius_mm), 0.0, 0.0, 0.0)
            image = sensor.frame((press,), _PRESS_NOISE + 10 * k + seq).image
            result = made.step(Frame(seq, 0, 0, image))
            points = thin_points(press_points(result.height, calibration.geometry))
            if result.contact and len(points):
                out.points.append(points)
                out.base_T_sensor.append(at)
                out.press.append(k)
                out.above_mm.append(above_mm)
    return out


def frames_of(got: Taken, noise: tuple[float, float], delay_ms: float, seed: int) -> list[ContactFrame]:
    """The frames with the robot's reported poses and late time stamps."""
    rest = [shift(0, 0, -abs(above)) @ pose for pose, above in zip(got.base_T_sensor, got.above_mm, strict=True)]
    first = {press: k for k, press in reversed(list(enumerate(got.press)))}
    noisy = pads.disturbed([rest[first[press]] for press in sorted(first)], got.radius_mm, *noise, seed=seed)
    flanges = {press: pose @ TRUE.inverse() for press, pose in zip(sorted(first), noisy, strict=True)}
    numbers = {press: k for k, press in enumerate(sorted(first))}
    frames = []
    for press, above_mm, points in zip(got.press, got.above_mm, got.points, strict=True):
        if above_mm:
            t_ns = flange_plan.MIDDLE_NS + round(flange_plan.time_s(above_mm) * 1e9 + delay_ms * 1e6)
            frames.append(ContactFrame(points, numbers[press], t_ns, flange_plan.track(flanges[press], press % 7 / 7)))
        else:
            frames.append(ContactFrame(points, numbers[press], 0, (Pose(0, *flanges[press].seven()),)))
    return frames


def errors(found: FoundFlange, delay_ms: float) -> F64:
    """Errors in mm, degrees and ms, in the order of the covariance."""
    turned, _ = cv2.Rodrigues(found.flange_T_sensor.rotation @ TRUE.rotation.T)
    moved_mm = found.flange_T_sensor.translation_mm - TRUE.translation_mm
    return np.concatenate((moved_mm, np.degrees(turned.ravel()), (found.delay_ms - delay_ms,)))


def row(noise: tuple[float, float], found: Sequence[tuple[F64, F64]]) -> tuple[str, ...]:
    """A table line with the errors and standard deviations of many trials."""
    off, sigma = np.stack([e for e, _ in found]), np.stack([s for _, s in found])
    mm, deg, ms = np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:6], axis=1), np.abs(off[:, 6])
    within = (np.abs(off) <= WITHIN_SIGMAS * sigma).mean()
    columns = [f"{noise[0]:g} mm, {noise[1]:g}°"]
    for values, limit in ((mm, WITHIN_MM), (deg, WITHIN_DEG), (ms, WITHIN_MS)):
        columns.append(f"{np.median(values):.2f}, {values.max():.2f}; {(values <= limit).sum()} of {len(values)}")
    return (*columns, f"{100 * within:.0f} %", f"{np.sqrt(np.mean((off / sigma) ** 2)):.2f}")


def write_recording(
    path: Path,
    picture: Callable[[tuple[Press, ...], int], U8],
    calibration: Calibration,
    presses: int,
    turns: flange_plan.Turns,
    noise: tuple[float, float],
) -> None:
    """Write a recording of the plan's first presses, and ``cal.npz`` with the flange pose that the robot believes.

    The robot moves down and up at 10 mm/s; every frame is stamped `DELAY_S` later than the robot's poses. `picture`
    draws presses with a seed of the noise.
    """
    path.mkdir(parents=True)
    start, radius_mm = start_of(0), calibration.geometry.skin_radius_mm
    placed = replace(calibration, flange_T_sensor=tuple(start.seven()))
    calibration_file.save(path / "cal.npz", calibration_file.with_crc(placed))
    cv2.imwrite(str(path / "free.png"), picture((), 0))
    surface = relief(1)
    plan = flange_plan.plan(surface.width_mm / 2, surface.length_mm / 2, radius_mm, turns)[:presses]
    true = [lowered(pose @ start.inverse() @ TRUE, radius_mm, surface, DEPTH_MM) for pose in plan]
    reported = [pose @ TRUE.inverse() for pose in pads.disturbed(true, radius_mm, *noise, seed=0)]
    rows = ["image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz"]
    for k, (base_T_sensor, base_T_flange) in enumerate(zip(true, reported, strict=True)):
        for t_s in (_PERIOD_S * np.arange(-_SPAN, _SPAN + 1)).tolist():
            above_mm, name = flange_plan.height_mm(t_s), "free.png"
            if above_mm < DEPTH_MM:
                name = f"{k:03}-{above_mm:.3f}.png"
                if not (path / name).exists():
                    shape = surface.under(shift(0, 0, above_mm) @ base_T_sensor, radius_mm)
                    cv2.imwrite(str(path / name), picture((Press(shape, 0.0, 0.0, 0.0),), 10 * k))
            stamp_s = t_s + DELAY_S
            pose = shift(0, 0, flange_plan.height_mm(stamp_s)) @ base_T_flange
            t_ns = round(1e9 * (1 + k * _TAKES_S + stamp_s))
            rows.append(",".join((name, str(t_ns), *(f"{value:.9f}" for value in pose.seven()))))
    (path / "frames.csv").write_text("\n".join(rows) + "\n")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--profile", choices=PROFILES, default="accurate")
    parser.add_argument("--final", dest="sensors", action="store_const", const=FINAL, default=SENSORS)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    found: dict[tuple[float, float], list[tuple[F64, F64]]] = {noise: [] for noise in NOISES}
    for trial in range(args.trials):
        got = taken(trial, args.sensors[trial % len(SENSORS)], args.profile)
        delay_ms = float(np.random.default_rng((trial, 33)).uniform(*DELAY_MS))
        for noise, rows in found.items():
            result = find_flange(frames_of(got, noise, delay_ms, trial), start_of(trial), got.radius_mm)
            rows.append((errors(result, delay_ms), np.sqrt(np.diag(result.covariance))))
    limits = (f"mm: median, worst; within {WITHIN_MM}", f"degrees; within {WITHIN_DEG}", f"ms; within {WITHIN_MS:g}")
    columns = ("noise of the poses", *limits, f"within {WITHIN_SIGMAS} standard deviations", "RMS in those")
    print(markdown(columns, [row(noise, here) for noise, here in found.items()]))


if __name__ == "__main__":
    main()
