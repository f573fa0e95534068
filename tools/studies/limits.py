"""The limits of reconstruction: phantoms, least and greatest depth, finest shape, disturbed frames.

::

    .venv/bin/python -m tools.studies.limits [--profile NAME...] [--sensors SEED,... | --final]
        [--out DIR]
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np

from tacshade_edge.lab.parallel import Report, Workers, reported_map
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball, bars, ridge
from tacshade_edge.lab.simulator.render import project
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.truth import SimulatedFrame, SimulatedSensor, skin_points
from tacshade_edge.lab.studies.evaluate.work import (
    NULL_NOISE,
    SCENE_NOISE,
    PressedSensor,
    SensorName,
    calibrated_sensor,
    reconstructor,
)
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F64, Calibration, Frame, HeightMap
from tools.studies import command
from tools.studies.disturbances import BEYOND, CHANGES, RELEASED, UNDISTURBED, without_contact
from tools.studies.limit_rows import (
    KINDS,
    DeepRow,
    DepthRow,
    DisturbedRow,
    FaintRow,
    FineRow,
    Found,
    NullRow,
    Plan,
    found,
)
from tools.studies.limit_tables import text

_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


@dataclass(frozen=True, slots=True, eq=False)
class Across:
    """A line in the image through a press's middle, along the press's own x axis,
    with a point for each pixel (N,).

    `x_mm` is the coordinate along this axis of the skin point that a pixel shows,
    `true_mm` its true h.
    """

    x_mm: F64
    true_mm: F64
    row: F64
    col: F64


REACH_MM = 12.0


def across(frame: SimulatedFrame, press: Press) -> Across:
    """Place the line, with points one pixel apart, and compute the true skin along it."""
    geometry, r = frame.model.geometry, frame.model.skin_radius_mm
    turn = math.radians(press.rotation_deg)
    along = np.array((math.cos(turn), math.sin(turn)))
    middle = np.array((press.x_mm, press.y_mm, press.lowest_z_mm(r)))
    col, row = project(geometry, middle[None])[0]
    reach = int(REACH_MM / geometry.mm_per_px)
    t = np.arange(-reach, reach + 1)
    col, row = col + t * along[0], row + t * along[1]
    inside = (
        np.hypot(row - geometry.disc.row_c, col - geometry.disc.col_c) < geometry.disc.radius_px - 1
    )
    row, col = row[inside], col[inside]
    points = skin_points(frame.skin, geometry, row, col)
    x = (points[:, :2] - middle[:2]) @ along
    return Across(x, r - np.linalg.norm(points, axis=1), row, col)


def found_heights(line: Across, height: HeightMap) -> F64:
    """Sample a height map at the line's pixels; NaN where the map has no height."""
    j, i = (line.col - height.col0) / height.step_px, (line.row - height.row0) / height.step_px
    map_mm = np.ascontiguousarray(height.height_mm)
    sampled = cv2.remap(
        map_mm, j.astype(np.float32)[:, None], i.astype(np.float32)[:, None], cv2.INTER_LINEAR
    )
    return np.asarray(sampled[:, 0], np.float64)


def dip_mm(x_mm: F64, h_mm: F64, width_mm: float, gap_mm: float) -> float:
    """Compute how far in mm the gap's lowest point lies below the lower of the two bars' maxima."""
    side = np.abs(x_mm) - gap_mm / 2
    bar = (side >= 0) & (side <= width_mm)
    left, right, middle = h_mm[bar & (x_mm < 0)], h_mm[bar & (x_mm > 0)], h_mm[side < 0]
    return float(min(np.nanmax(left), np.nanmax(right)) - np.nanmin(middle))


def top_mm(x_mm: F64, h_mm: F64, width_mm: float) -> float:
    """Find the greatest h in mm over a ridge and half a millimetre on either side."""
    return float(np.nanmax(h_mm[np.abs(x_mm) <= width_mm / 2 + 0.5]))


def places(
    model: SensorModel, count: int, reach_radii: float, seed: int | None
) -> list[tuple[float, float]]:
    """Spread places (x, y) in mm on a sunflower spiral out to `reach_radii` skin radii,
    turned by the sensor's seed.
    """
    turn = np.random.default_rng((0 if seed is None else seed + 1, 32)).uniform(0, 2 * math.pi)
    spread = []
    for k in range(count):
        rho, angle = (
            reach_radii * model.skin_radius_mm * math.sqrt((k + 0.5) / count),
            turn + k * _GOLDEN_ANGLE,
        )
        spread.append((round(rho * math.cos(angle), 3), round(rho * math.sin(angle), 3)))
    return spread


def ball_press(
    skin_radius_mm: float, radius_mm: float, x_mm: float, y_mm: float, height_mm: float
) -> Press:
    """Press a ball until the skin's greatest h is `height_mm`;
    off the axis, its lowest point is not the deepest.
    """
    rho2 = x_mm**2 + y_mm**2
    lowest = math.sqrt((skin_radius_mm + radius_mm - height_mm) ** 2 - rho2) - radius_mm
    return Press(ball(radius_mm), x_mm, y_mm, math.sqrt(skin_radius_mm**2 - rho2) - lowest)


def cylinder_press(
    skin_radius_mm: float, radius_mm: float, x_mm: float, y_mm: float, height_mm: float
) -> Press:
    """Press the flat cylinder until the skin's greatest h, which is at the tip, is `height_mm`."""
    up = math.sqrt(skin_radius_mm**2 - x_mm**2 - y_mm**2) - skin_radius_mm
    return Press(OBJECTS["cylinder"](), x_mm, y_mm, height_mm + up)


_Task = tuple[Plan, SensorName, Calibration]


def limits(
    plan: Plan, pool: Workers, report: Report, fitted: Mapping[SensorName, Path] | None = None
) -> list[Found]:
    """Run a plan, with fitted calibrations if there are some.

    Raises ConfigError (a sensor cannot be calibrated) and DeviceError (a worker was killed).
    """
    made = command.calibrations(fitted, plan.sensors, plan.references, plan.presses, pool, report)
    known = [
        (plan, name, calibration) for name, calibration in zip(plan.sensors, made, strict=True)
    ]
    # The longest jobs come first, so that no core waits at the end.
    jobs: list[tuple[Callable[[Any], Sequence[Found]], Any]] = [
        *((_fine, (plan, pitch)) for pitch in plan.pitches_mm),
        *((job, task) for job in (_deep, _faint, _nulls, _disturbed) for task in known),
    ]
    return [
        row for rows in reported_map(_run, jobs, pool, report, "parts of the study") for row in rows
    ]


def _run(job: tuple[Callable[[Any], Sequence[Found]], Any]) -> Sequence[Found]:
    function, task = job
    return function(task)


def _made(task: _Task) -> tuple[PressedSensor, list[Reconstructor]]:
    plan, name, calibration = task
    return name.make(), [reconstructor(calibration, profile) for profile in plan.profiles]


def _nulls(task: _Task) -> list[NullRow]:
    plan, name, _ = task
    sensor, made = _made(task)
    first = 1000 * (0 if name.seed is None else name.seed + 1)
    rows: list[NullRow] = []
    usual, beyond = (*CHANGES, RELEASED), tuple(BEYOND)
    for kinds, count in ((usual, plan.null_frames), (beyond, plan.beyond_frames)):
        for what in (kinds[k % len(kinds)] for k in range(math.ceil(count / len(plan.sensors)))):
            k = len(rows) // len(made)
            image = without_contact(sensor, what, first + k, NULL_NOISE + k)
            rows += [NullRow(*found(each, image)[0], str(name), what, first + k) for each in made]
    return rows


def _faint(task: _Task) -> list[FaintRow]:
    plan = task[0]
    balls = [("ball", ball_press, radius) for radius in plan.ball_radii_mm]
    return _pressed(task, FaintRow, balls, plan.faint_depths_mm, plan.faint_places, 0.4)


def _deep(task: _Task) -> list[DeepRow]:
    plan = task[0]
    # The cylinder covers the tip from each of these places.
    shapes = [("ball", ball_press, 6.0), ("cylinder", cylinder_press, 5.0)]
    return _pressed(task, DeepRow, shapes, plan.depths_mm, plan.deep_places, 0.15)


_Depth = TypeVar("_Depth", bound=DepthRow)


def _pressed(
    task: _Task,
    kind: type[_Depth],
    shapes: Sequence[tuple[str, Callable[[float, float, float, float, float], Press], float]],
    depths_mm: Sequence[float],
    count: int,
    reach_radii: float,
) -> list[_Depth]:
    name = task[1]
    sensor, made = _made(task)
    rows = []
    for object_name, press_to, radius in shapes:
        for k, (x, y) in enumerate(places(sensor.model, count, reach_radii, name.seed)):
            for depth in depths_mm:
                press = press_to(sensor.model.skin_radius_mm, radius, x, y, depth)
                frame = sensor.frame((press,), SCENE_NOISE + k)
                where = (
                    str(name),
                    object_name,
                    radius,
                    depth,
                    x,
                    y,
                    float(frame.skin.height_mm.max()),
                )
                rows += [kind(*found(each, frame.image)[0], *where) for each in made]
    return rows


def _fine(task: tuple[Plan, float]) -> list[FineRow]:
    plan, pitch = task
    name, width = plan.sensors[0], plan.bar_width_mm
    sensor: PressedSensor = SimulatedSensor(replace(name.make().model, pitch_mm=pitch))
    calibration = calibrated_sensor(
        sensor, name.seed or 0, plan.references, plan.presses
    ).calibration
    made = [reconstructor(calibration, profile) for profile in plan.profiles]
    shapes = [
        (bars(width, gap), gap, partial(dip_mm, width_mm=width, gap_mm=gap)) for gap in plan.gaps_mm
    ]
    shapes += [(ridge(size), size, partial(top_mm, width_mm=size)) for size in plan.widths_mm]
    rows = []
    for k, (x, y) in enumerate(places(sensor.model, plan.fine_places, 0.1, name.seed)):
        for shape, size, height in shapes:
            press = Press(shape, x, y, plan.fine_depth_mm, 180.0 * k / plan.fine_places)
            frame = sensor.frame((press,), SCENE_NOISE + k)
            line = across(frame, press)
            where, true_mm = (
                (pitch, shape.name, size, x, y, press.rotation_deg),
                height(line.x_mm, line.true_mm),
            )
            for each in made:
                seen, map_mm = found(each, frame.image)
                rows.append(
                    FineRow(*seen, *where, true_mm, height(line.x_mm, found_heights(line, map_mm)))
                )
    return rows


def _disturbed(task: _Task) -> list[DisturbedRow]:
    plan, name, _ = task
    sensor, made = _made(task)
    first = 1000 * (0 if name.seed is None else name.seed + 1)
    rows = []
    for k, (x, y) in enumerate(places(sensor.model, plan.disturbed_places, 0.3, name.seed)):
        frame = sensor.frame(
            (ball_press(sensor.model.skin_radius_mm, 6.0, x, y, 2.0),), SCENE_NOISE + k
        )
        clean = [each.step(Frame(0, 0, 0, frame.image)).depth_max_mm for each in made]
        for what in (what for what in CHANGES if what != UNDISTURBED):
            image = CHANGES[what](frame.image, sensor.model, np.random.default_rng((first + k, 33)))
            press = (str(name), what, first + k, x, y, float(frame.skin.height_mm.max()))
            rows += [
                DisturbedRow(*found(each, image)[0], *press, mm)
                for each, mm in zip(made, clean, strict=True)
            ]
    return rows


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = command.options("Where the method ends.", "default,5,11")
    args = parser.parse_args(words)
    plan = Plan(args.sensors, tuple(args.profile))
    if args.fitted is not None:  # only frames that a fit may take for others
        plan = replace(plan, pitches_mm=(), faint_places=0, deep_places=0)
    work = partial(limits, plan, fitted=args.fitted)
    command.run(parser, args, "limits", work, text, KINDS)


if __name__ == "__main__":
    main()
