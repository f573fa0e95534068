"""The jobs of the study of limits: the presses and disturbances that each sensor sees."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import Any

import numpy as np

from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import OBJECTS, ball, bars, ridge
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.studies.evaluate.sensors import (
    NULL_NOISE,
    PRESSES,
    REFERENCES,
    SCENE_NOISE,
    PressedSensor,
    SensorName,
    calibrate_sensors,
    calibrated_sensor,
    reconstructor,
)
from tacshade_edge.studies.parallel import Report, Workers, reported_map
from tacshade_edge.types import U8, Calibration, Frame, Reconstruction
from tools.studies.limits.across import across, dip_mm, found_heights, top_mm
from tools.studies.limits.disturbances import BEYOND, CHANGES, UNDISTURBED, WITHOUT_CONTACT, without_contact
from tools.studies.limits.rows import DepthRow, DisturbedRow, FineRow, Found, NullRow, found

_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))

_Job = tuple[Callable[[Any], Sequence[Found]], Any]


@dataclass(frozen=True, slots=True)
class Plan:
    """The parameters of a study; equal plans give equal rows. Lengths are in mm for every skin radius;
    depths are the skin's greatest h.

    Attributes
    ----------
    sensors : tuple of SensorName
    profiles : tuple of str
    references, presses : int
        Numbers of references and presses on which each sensor is calibrated.
    null_frames, beyond_frames : int
        Frames without contact over all sensors, with the disturbances of normal use and with greater ones (`BEYOND`).
    ball_radii_mm, faint_depths_mm : tuple of float
        Balls and depths that may be too faint to detect, at `faint_places` places of each sensor.
    depths_mm : tuple of float
        Depths of a ball with a radius of 6 mm and of a cylinder, at `deep_places` places.
    pitches_mm : tuple of float
        Marker pitches with which the first sensor is printed again.
    gaps_mm, widths_mm : tuple of float
        Gaps between bars of `bar_width_mm`, and widths of a ridge, pressed `fine_depth_mm` deep (along z at the place)
        at `fine_places` places.
    disturbed_places : int
        Number of contacts 2 mm deep for each disturbance and sensor.
    """

    sensors: tuple[SensorName, ...]
    profiles: tuple[str, ...]
    references: int = REFERENCES
    presses: int = PRESSES
    null_frames: int = 1000
    beyond_frames: int = 300
    ball_radii_mm: tuple[float, ...] = (3.0, 6.0, 9.0)
    faint_depths_mm: tuple[float, ...] = (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.8, 1.0, 1.5)
    faint_places: int = 12
    depths_mm: tuple[float, ...] = tuple(0.5 * k for k in range(1, 17))
    deep_places: int = 8
    pitches_mm: tuple[float, ...] = (1.4, 1.6, 1.8, 2.0, 2.2, 2.4)
    gaps_mm: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)
    widths_mm: tuple[float, ...] = (0.4, 0.6, 0.8, 1.0, 1.5, 2.0, 3.0, 4.0)
    bar_width_mm: float = 2.0
    fine_depth_mm: float = 2.5
    fine_places: int = 6
    disturbed_places: int = 16


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """All rows of a plan."""

    nulls: tuple[NullRow, ...]
    faint: tuple[DepthRow, ...]
    deep: tuple[DepthRow, ...]
    fine: tuple[FineRow, ...]
    disturbed: tuple[DisturbedRow, ...]

    def tables(self) -> list[tuple[str, Sequence[Found]]]:
        """List the tables by name."""
        return [(field.name, getattr(self, field.name)) for field in fields(self)]


def limits(plan: Plan, workers: Workers, report: Report) -> Limits:
    """Run a plan. Raises ConfigError (a sensor cannot be calibrated) and DeviceError (a worker was killed)."""
    calibrations = calibrate_sensors(plan.sensors, plan.references, plan.presses, workers, report)
    known = [(plan, name, made.calibration) for name, made in zip(plan.sensors, calibrations, strict=True)]
    # The longest jobs come first, so that no core waits at the end.
    jobs: list[_Job] = [
        *((_fine, (plan, pitch)) for pitch in plan.pitches_mm),
        *((job, task) for job in (_deep, _faint, _nulls, _disturbed) for task in known),
    ]
    rows = list(chain.from_iterable(reported_map(_run, jobs, workers, report, "parts of the study")))
    return Limits(
        tuple(r for r in rows if isinstance(r, NullRow)),
        tuple(r for r in rows if isinstance(r, DepthRow) and r.faint),
        tuple(r for r in rows if isinstance(r, DepthRow) and not r.faint),
        tuple(r for r in rows if isinstance(r, FineRow)),
        tuple(r for r in rows if isinstance(r, DisturbedRow)),
    )


def _run(job: _Job) -> Sequence[Found]:
    function, task = job
    return function(task)


def _reconstructors(plan: Plan, calibration: Calibration) -> list[Reconstructor]:
    return [reconstructor(calibration, profile) for profile in plan.profiles]


def _step(each: Reconstructor, image: U8) -> Reconstruction:
    return each.step(Frame(0, 0, 0, image))


def places(model: SensorModel, count: int, reach_radii: float, seed: int | None) -> list[tuple[float, float]]:
    """Spread places (x, y) in mm on a sunflower spiral out to `reach_radii` skin radii, turned by the sensor's seed."""
    turn = np.random.default_rng((0 if seed is None else seed + 1, 32)).uniform(0, 2 * math.pi)
    spread = []
    for k in range(count):
        rho, angle = reach_radii * model.skin_radius_mm * math.sqrt((k + 0.5) / count), turn + k * _GOLDEN_ANGLE
        spread.append((round(rho * math.cos(angle), 3), round(rho * math.sin(angle), 3)))
    return spread


def _nulls(task: tuple[Plan, SensorName, Calibration]) -> list[NullRow]:
    plan, name, calibration = task
    sensor, made = name.make(), _reconstructors(plan, calibration)
    first = 1000 * (0 if name.seed is None else name.seed + 1)
    rows = []
    within, beyond = (math.ceil(n / len(plan.sensors)) for n in (plan.null_frames, plan.beyond_frames))
    kinds = [WITHOUT_CONTACT[k % len(WITHOUT_CONTACT)] for k in range(within)]
    kinds += [list(BEYOND)[k % len(BEYOND)] for k in range(beyond)]
    for k, what in enumerate(kinds):
        image = without_contact(sensor, what, first + k, NULL_NOISE + k)
        rows += [NullRow(*found(_step(each, image)), str(name), what, first + k) for each in made]
    return rows


def ball_press(skin_radius_mm: float, radius_mm: float, x_mm: float, y_mm: float, height_mm: float) -> Press:
    """Press a ball until the skin's greatest h is `height_mm`; off the axis, its lowest point is not the deepest."""
    rho2 = x_mm**2 + y_mm**2
    lowest = math.sqrt((skin_radius_mm + radius_mm - height_mm) ** 2 - rho2) - radius_mm
    return Press(ball(radius_mm), x_mm, y_mm, math.sqrt(skin_radius_mm**2 - rho2) - lowest)


def cylinder_press(skin_radius_mm: float, radius_mm: float, x_mm: float, y_mm: float, height_mm: float) -> Press:
    """Press the flat cylinder until the skin's greatest h, which is at the tip, is `height_mm`."""
    up = math.sqrt(skin_radius_mm**2 - x_mm**2 - y_mm**2) - skin_radius_mm
    return Press(OBJECTS["cylinder"](), x_mm, y_mm, height_mm + up)


def _faint(task: tuple[Plan, SensorName, Calibration]) -> list[DepthRow]:
    plan = task[0]
    balls = [("ball", ball_press, radius) for radius in plan.ball_radii_mm]
    return _pressed(task, True, balls, plan.faint_depths_mm, plan.faint_places, 0.4)


def _deep(task: tuple[Plan, SensorName, Calibration]) -> list[DepthRow]:
    plan = task[0]
    # The cylinder covers the tip from each of these places.
    shapes = [("ball", ball_press, 6.0), ("cylinder", cylinder_press, 5.0)]
    return _pressed(task, False, shapes, plan.depths_mm, plan.deep_places, 0.15)


def _pressed(
    task: tuple[Plan, SensorName, Calibration],
    faint: bool,
    shapes: Sequence[tuple[str, Callable[[float, float, float, float, float], Press], float]],
    depths_mm: Sequence[float],
    count: int,
    reach_radii: float,
) -> list[DepthRow]:
    plan, name, calibration = task
    sensor, made = name.make(), _reconstructors(plan, calibration)
    rows = []
    for object_name, press_to, radius in shapes:
        for k, (x, y) in enumerate(places(sensor.model, count, reach_radii, name.seed)):
            for depth in depths_mm:
                press = press_to(sensor.model.skin_radius_mm, radius, x, y, depth)
                frame = sensor.frame((press,), SCENE_NOISE + k)
                true = float(frame.skin.height_mm.max())
                for each in made:
                    result = found(_step(each, frame.image))
                    rows.append(DepthRow(*result, str(name), faint, object_name, radius, depth, x, y, true))
    return rows


def _fine(task: tuple[Plan, float]) -> list[FineRow]:
    plan, pitch = task
    name = plan.sensors[0]
    sensor: PressedSensor = SimulatedSensor(replace(name.make().model, pitch_mm=pitch))
    made = _reconstructors(plan, calibrated_sensor(sensor, name.seed or 0, plan.references, plan.presses).calibration)
    spread = places(sensor.model, plan.fine_places, 0.1, name.seed)
    rows = []
    for k, (x, y) in enumerate(spread):
        turn = 180.0 * k / plan.fine_places
        for gap in plan.gaps_mm:
            press = Press(bars(plan.bar_width_mm, gap), x, y, plan.fine_depth_mm, turn)
            rows += _fine_rows(sensor, made, press, pitch, gap, SCENE_NOISE + k, plan.bar_width_mm)
        for width in plan.widths_mm:
            press = Press(ridge(width), x, y, plan.fine_depth_mm, turn)
            rows += _fine_rows(sensor, made, press, pitch, width, SCENE_NOISE + k, None)
    return rows


def _fine_rows(
    sensor: PressedSensor,
    made: Sequence[Reconstructor],
    press: Press,
    pitch_mm: float,
    size_mm: float,
    noise_seed: int,
    bar_width_mm: float | None,
) -> list[FineRow]:
    frame = sensor.frame((press,), noise_seed)
    line = across(frame, press)
    rows = []
    for each in made:
        result = _step(each, frame.image)
        heights = found_heights(line, result.height)
        if bar_width_mm is None:
            true, got = (top_mm(line.x_mm, h, size_mm) for h in (line.true_mm, heights))
        else:
            true, got = (dip_mm(line.x_mm, h, bar_width_mm, size_mm) for h in (line.true_mm, heights))
        where = (pitch_mm, press.shape.name, size_mm, press.x_mm, press.y_mm, press.rotation_deg)
        rows.append(FineRow(*found(result), *where, true, got))
    return rows


def _disturbed(task: tuple[Plan, SensorName, Calibration]) -> list[DisturbedRow]:
    plan, name, calibration = task
    sensor, made = name.make(), _reconstructors(plan, calibration)
    first = 1000 * (0 if name.seed is None else name.seed + 1)
    rows = []
    for k, (x, y) in enumerate(places(sensor.model, plan.disturbed_places, 0.3, name.seed)):
        frame = sensor.frame((ball_press(sensor.model.skin_radius_mm, 6.0, x, y, 2.0),), SCENE_NOISE + k)
        clean = [_step(each, frame.image).depth_max_mm for each in made]
        for what, change in CHANGES.items():
            if what == UNDISTURBED:
                continue
            image = change(frame.image, sensor.model, np.random.default_rng((first + k, 33)))
            press = (str(name), what, first + k, x, y, float(frame.skin.height_mm.max()))
            rows += [
                DisturbedRow(*found(_step(each, image)), *press, clean_mm)
                for each, clean_mm in zip(made, clean, strict=True)
            ]
    return rows
