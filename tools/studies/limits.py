"""The limits of reconstruction: phantoms, least and greatest depth, finest shape, disturbed frames.

::

    .venv/bin/python -m tools.studies.limits [--profile NAME...] [--sensors SEED,... | --final]
        [--out DIR]
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np

from support import bad_pictures
from tacshade_edge.lab.parallel import Report, Workers, reported_map
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball, bars, ridge
from tacshade_edge.lab.simulator.render import project
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.truth import SimulatedFrame, SimulatedSensor, skin_points
from tacshade_edge.lab.studies.evaluate.work import (
    NULL_NOISE,
    PRESSES,
    REFERENCES,
    SCENE_NOISE,
    PressedSensor,
    SensorName,
    calibrated_sensor,
    reconstructor,
)
from tacshade_edge.lab.studies.markdown import grouped, markdown, summary
from tacshade_edge.reasons import text_of
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F64, U8, Calibration, Frame, HeightMap
from tools.studies import command
from tools.testbed.simulator.families import released

Rng = np.random.Generator
Change = Callable[[U8, SensorModel, Rng], U8]
_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


@dataclass(frozen=True, slots=True)
class Plan:
    """The parameters of a study.

    Lengths are in mm for every skin radius; depths are the skin's greatest h.
    """

    sensors: tuple[SensorName, ...]
    profiles: tuple[str, ...]
    references: int = REFERENCES
    presses: int = PRESSES
    null_frames: int = 1000  # without contact over all sensors, with the disturbances of normal use
    beyond_frames: int = 300  # with greater ones (`BEYOND`)
    ball_radii_mm: tuple[float, ...] = (3.0, 6.0, 9.0)
    faint_depths_mm: tuple[float, ...] = (
        0.1,
        0.15,
        0.2,
        0.25,
        0.3,
        0.35,
        0.4,
        0.5,
        0.6,
        0.8,
        1.0,
        1.5,
    )
    faint_places: int = 12  # of each sensor
    depths_mm: tuple[float, ...] = tuple(
        0.5 * k for k in range(1, 17)
    )  # of a ball of 6 mm and a cylinder
    deep_places: int = 8
    pitches_mm: tuple[float, ...] = (
        1.4,
        1.6,
        1.8,
        2.0,
        2.2,
        2.4,
    )  # with which the first sensor is printed again
    gaps_mm: tuple[float, ...] = (
        0.5,
        1.0,
        1.5,
        2.0,
        2.5,
        3.0,
        3.5,
        4.0,
        5.0,
        6.0,
    )  # between bars of `bar_width_mm`
    widths_mm: tuple[float, ...] = (0.4, 0.6, 0.8, 1.0, 1.5, 2.0, 3.0, 4.0)  # of a ridge
    bar_width_mm: float = 2.0
    fine_depth_mm: float = 2.5  # along z at the place
    fine_places: int = 6
    disturbed_places: int = 16  # contacts 2 mm deep for each disturbance and sensor


@dataclass(frozen=True, slots=True)
class Found:
    """A reconstruction without its maps. `doubt` is why it is invalid or degraded, or empty."""

    profile: str
    valid: bool
    contact: bool
    saturated: bool
    found_mm: float
    objects: int
    doubt: str


def found(
    made: Reconstructor, image: U8
) -> tuple[tuple[str, bool, bool, bool, float, int, str], HeightMap]:
    """The fields of `Found`, which begin each row, and the map."""
    result = made.step(Frame(0, 0, 0, image))
    doubt = text_of(result.reason or result.degraded)
    seen = (
        result.valid,
        result.contact,
        result.saturated,
        result.depth_max_mm,
        len(result.objects),
        doubt,
    )
    return (result.profile, *seen), result.height


@dataclass(frozen=True, slots=True)
class NullRow(Found):
    """A frame without contact, in which `contact` is a phantom."""

    sensor: str
    disturbance: str
    seed: int


@dataclass(frozen=True, slots=True)
class DepthRow(Found):
    """A press to a greatest h of `depth_mm`; `true_mm` is the greatest h
    of the simulated skin's grid.
    """

    sensor: str
    object: str
    radius_mm: float
    depth_mm: float
    x_mm: float
    y_mm: float
    true_mm: float


class FaintRow(DepthRow):
    """In the search for the least depth."""


class DeepRow(DepthRow):
    """In the search for the greatest depth."""


@dataclass(frozen=True, slots=True)
class FineRow(Found):
    """Two bars with a gap (`size_mm`), or a ridge with a width (`size_mm`),
    on a sensor with a marker pitch.

    For bars, `true_height_mm` and `found_height_mm` are the dip of h between them;
    for a ridge, its greatest h.
    """

    pitch_mm: float
    shape: str
    size_mm: float
    x_mm: float
    y_mm: float
    rotation_deg: float
    true_height_mm: float
    found_height_mm: float


@dataclass(frozen=True, slots=True)
class DisturbedRow(Found):
    """A contact in a disturbed image.

    `clean_mm` is the depth from the same frame without the disturbance.
    """

    sensor: str
    disturbance: str
    seed: int
    x_mm: float
    y_mm: float
    true_mm: float
    clean_mm: float

    @property
    def off(self) -> float:
        """Relative difference between the depth and the undisturbed frame's;
        a lost contact counts as 1.
        """
        return abs(self.found_mm / self.clean_mm - 1)

    @property
    def silently_wrong(self) -> bool:
        """Whether the contact is lost or has a wrong depth,
        and nothing warns a program to trust it less.
        """
        return self.off > WRONG and self.valid and not self.doubt and not self.saturated


KINDS = {
    "_nulls": NullRow,
    "_faint": FaintRow,
    "_deep": DeepRow,
    "_fine": FineRow,
    "_disturbed": DisturbedRow,
}

UNDISTURBED = "nothing"
RELEASED = "after a release"
"""Nothing touches, but the skin keeps 2 to 10 % of the dent
(up to 0.4 mm) of a ball pressed 2 to 4 mm deep.
"""
LEFT = (0.02, 0.1)


def _glare(image: U8, model: SensorModel, rng: Rng) -> U8:
    rho, angle = 0.9 * model.disc_radius_px * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
    sigma, level = float(rng.uniform(2, 20)), float(rng.uniform(60, 255))
    row, col = model.row_c + rho * math.sin(angle), model.col_c + rho * math.cos(angle)
    return camera_faults.glare(image, row, col, sigma, level)


def _aged(image: U8, model: SensorModel, rng: Rng) -> U8:
    loss, angle = float(rng.uniform(0.1, 0.4)), float(rng.uniform(0, 360))
    return camera_faults.uneven(image, model.row_c, model.col_c, model.disc_radius_px, loss, angle)


def _noisy(low: float, high: float) -> Change:
    return lambda image, _, rng: camera_faults.noise(
        image, float(rng.uniform(low, high)), int(rng.integers(1 << 30))
    )


CHANGES: dict[str, Change] = {
    UNDISTURBED: lambda image, model, rng: image,
    "light within 20 %": lambda image, _, rng: camera_faults.gain(
        image, float(rng.uniform(0.8, 1.2))
    ),
    "one side dims by 10 to 40 %": _aged,
    "glare spot": _glare,
    "warm-up": lambda image, m, rng: bad_pictures.warm(
        image, m.row_c, m.col_c, float(rng.uniform(0, 1))
    ),
    "moved by 1 px": lambda image, _, rng: camera_faults.shift(
        image, *((1, 0), (-1, 0), (0, 1), (0, -1))[rng.integers(4)]
    ),
    "noise of 2 to 10 levels": _noisy(2, 10),
}
"""Changes of an image, by name.

Glare has a standard deviation of 2 to 20 px and 60 to 255 levels.
"""


def _far_light(image: U8, model: SensorModel, rng: Rng) -> U8:
    return camera_faults.gain(image, float(rng.choice((0.3, 0.5, 0.7, 1.3, 1.5, 2.0, 3.0))))


def _far_moved(image: U8, model: SensorModel, rng: Rng) -> U8:
    rows, cols = (int(rng.choice((-1, 1)) * rng.integers(2, 6)) for _ in range(2))
    return camera_faults.shift(image, rows, cols)


def _torn_row(model: SensorModel, rng: Rng) -> int:
    return round(
        model.row_c + model.disc_radius_px * float(rng.choice((-0.6, -0.3, 0.0, 0.3, 0.6)))
    )


def _sideways(px: int) -> Change:
    def change(image: U8, model: SensorModel, rng: Rng) -> U8:
        scaled_px = round(px * model.image_width_px / 640)
        return bad_pictures.torn(
            image, image, _torn_row(model, rng), scaled_px * int(rng.choice((-1, 1)))
        )

    return change


def _repeated(image: U8, model: SensorModel, rng: Rng) -> U8:
    row = _torn_row(model, rng)
    return np.concatenate((image[:row], np.broadcast_to(image[row], image[row:].shape)))


def _down(image: U8, model: SensorModel, rng: Rng) -> U8:
    row, px = _torn_row(model, rng), round(40 * model.image_height_px / 480)
    return np.concatenate((image[:row], image[row - px : len(image) - px]))


def _flat_below(image: U8, model: SensorModel, rng: Rng) -> U8:
    return bad_pictures.torn(
        image, np.full_like(image, int(rng.choice((0, 128)))), _torn_row(model, rng)
    )


BEYOND: dict[str, Change] = {
    "light x0.3 to x3": _far_light,
    "moved by 3 to 7 px": _far_moved,
    "noise of 15 to 50 levels": _noisy(15, 50),
    "blur of 1 to 5 px": lambda image, _, rng: bad_pictures.defocus(
        image, float(rng.uniform(1, 5))
    ),
    "torn: rows sideways by 60 px": _sideways(60),
    "torn: rows sideways by 200 px": _sideways(200),
    "torn: one row again and again": _repeated,
    "torn: rows down by 40 px": _down,
    "torn: black or grey below": _flat_below,
}
"""Disturbances that are not compensated; at best, the result is invalid or degraded.

A tear begins at one of five rows, and pixels are those of a 640x480 image.
"""


def without_contact(sensor: PressedSensor, what: str, seed: int, noise_seed: int) -> U8:
    """Take an image without contact, disturbed by `CHANGES`, `RELEASED` or `BEYOND`,
    drawn from the seed.
    """
    rng = np.random.default_rng((seed, 31))
    if what == RELEASED:
        model = sensor.model
        rho, angle = model.skin_radius_mm * rng.uniform(0, 0.4), rng.uniform(0, 2 * math.pi)
        radius, depth, part = rng.uniform(3, 9), rng.uniform(2, 4), rng.uniform(*LEFT)
        press = Press(ball(radius), rho * math.cos(angle), rho * math.sin(angle), depth)
        return released(sensor, (press,), part, noise_seed).image
    return (CHANGES | BEYOND)[what](sensor.frame((), noise_seed).image, sensor.model, rng)


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


DETECTED = 0.95
"""Share of presses that must be found for a depth to count as detected."""
RESOLVED = 0.75
"""Share of places at which a gap or ridge must be resolved."""
DIP_PART, LEAST_DIP_MM, RIDGE_OFF = 0.5, 0.05, 0.2
"""A gap is resolved if h dips by at least half of the true dip,
and a ridge if its height is within a fifth.
"""
WRONG = 0.25
"""Relative error above which a depth counts as wrong."""
FINE: dict[str, tuple[str, Callable[[FineRow], bool]]] = {
    "gap: two objects": ("bars", lambda row: row.objects == 2),
    "gap: half the dip": (
        "bars",
        lambda row: row.found_height_mm >= max(DIP_PART * row.true_height_mm, LEAST_DIP_MM),
    ),
    "ridge: height within 20 %": (
        "ridge",
        lambda r: abs(r.found_height_mm / r.true_height_mm - 1) <= RIDGE_OFF,
    ),
}
"""The questions about fine shapes, with the shape and the test of each."""


def detected(some: Sequence[DepthRow]) -> dict[float, float]:
    """Share of presses found by depth."""
    return {
        depth: float(np.mean([r.contact for r in of]))
        for depth, of in sorted(grouped(some, "depth_mm").items())
    }


def depth_errors(some: Sequence[DepthRow]) -> dict[float, tuple[float, float, float]]:
    """By depth: mean absolute error, its 90th percentile in mm, share reported as saturated."""
    made = {}
    for depth, here in sorted(grouped(some, "depth_mm").items()):
        off = np.abs([r.found_mm - r.true_mm for r in here])
        made[depth] = (
            float(off.mean()),
            float(np.quantile(off, 0.9)),
            float(np.mean([r.saturated for r in here])),
        )
    return made


def finest(rows: Sequence[FineRow], pitch_mm: float, question: str) -> float:
    """Find the size at and above which a shape is resolved at `RESOLVED` of the places;
    infinity if there is none.
    """
    shape, came_out = FINE[question]
    least = math.inf
    sizes = grouped((r for r in rows if r.pitch_mm == pitch_mm and r.shape == shape), "size_mm")
    for size, some in sorted(sizes.items(), reverse=True):
        if np.mean([came_out(r) for r in some]) < RESOLVED:
            break
        least = size
    return least


def by_profile(rows: Iterable[Found], kind: type[_Row]) -> dict[str, list[_Row]]:
    """The rows of a kind by profile."""
    return grouped((row for row in rows if isinstance(row, kind)), "profile")


_Row = TypeVar("_Row", bound=Found)

NULLS: dict[str, Callable[[Sequence[NullRow]], str]] = {
    "frames": lambda some: str(len(some)),
    "invalid": lambda some: str(sum(not r.valid for r in some)),
    "degraded": lambda some: str(sum(r.valid and bool(r.doubt) for r in some)),
    "phantoms": lambda some: str(sum(r.contact for r in some)),
    "silent ones": lambda some: str(sum(r.contact and not r.doubt for r in some)),
    "deepest mm": lambda some: f"{max(r.found_mm for r in some):.2f}",
}
DISTURBED: dict[str, Callable[[Sequence[DisturbedRow]], str]] = {
    "frames": lambda some: str(len(some)),
    "mean %": lambda some: f"{100 * np.mean([r.off for r in some]):.1f}",
    "worst %": lambda some: f"{100 * max(r.off for r in some):.0f}",
    "invalid": lambda some: str(sum(not r.valid for r in some)),
    "degraded": lambda some: str(sum(r.valid and bool(r.doubt) for r in some)),
    "lost": lambda some: str(sum(r.valid and not r.contact for r in some)),
    "silently > 25 %": lambda some: str(sum(r.silently_wrong for r in some)),
}


def text(rows: Sequence[Found]) -> str:
    """The tables, for a terminal and a document."""
    parts: tuple[tuple[str, Callable[[Any], str], type[Any]], ...] = (
        ("Nothing touches", _nulls_table, NullRow),
        ("The least depth: part of the presses that is found, %", _faint_table, FaintRow),
        ("The greatest depth: error of the greatest h, mm", _deep_table, DeepRow),
        ("The finest shape, mm", _fine_table, FineRow),
        ("A contact of 2 mm, disturbed: change of its depth, %", _disturbed_table, DisturbedRow),
    )
    of_kinds = ((title, table, by_profile(rows, kind)) for title, table, kind in parts)
    return "\n\n".join(f"{title}\n\n{table(some)}" for title, table, some in of_kinds if some)


def _nulls_table(profiles: Mapping[str, Sequence[NullRow]]) -> str:
    kinds = list(dict.fromkeys(row.disturbance for rows in profiles.values() for row in rows))
    within = [kind for kind in kinds if kind not in BEYOND]
    parts = {**{kind: [kind] for kind in within}, "all of these": within}
    parts |= {f"beyond: {kind}": [kind] for kind in kinds if kind in BEYOND}
    groups = [
        ((title, profile), [row for row in rows if row.disturbance in part])
        for title, part in parts.items()
        for profile, rows in profiles.items()
    ]
    return summary(("what", "method"), groups, NULLS)


def _faint_table(profiles: Mapping[str, Sequence[FaintRow]]) -> str:
    lines, depths = (
        [],
        dict.fromkeys(depth for rows in profiles.values() for depth in detected(rows)),
    )
    for radius in sorted({row.radius_mm for rows in profiles.values() for row in rows}):
        for profile, rows in profiles.items():
            parts = detected([row for row in rows if row.radius_mm == radius]).values()
            lines.append(
                [f"ball, radius {radius:g} mm", profile, *(f"{100 * part:.0f}" for part in parts)]
            )
    return markdown(["object", "method", *(f"{depth:g} mm" for depth in depths)], lines)


def _deep_table(profiles: Mapping[str, Sequence[DeepRow]]) -> str:
    lines: list[list[str]] = []
    for name in dict.fromkeys(row.object for rows in profiles.values() for row in rows):
        for profile, rows in profiles.items():
            known = depth_errors([row for row in rows if row.object == name])
            whole = [known[depth] for depth in known if depth == round(depth)]
            lines.append([f"{name}, mean", profile, *(f"{mean:.2f}" for mean, _, _ in whole)])
            lines.append([f"{name}, 90 %", profile, *(f"{high:.2f}" for _, high, _ in whole)])
            lines.append(
                [
                    f"{name}, saturated %",
                    profile,
                    *(f"{100 * saturated:.0f}" for *_, saturated in whole),
                ]
            )
    depths = dict.fromkeys(
        depth for rows in profiles.values() for depth in depth_errors(rows) if depth == round(depth)
    )
    return markdown(["object", "method", *(f"{depth:g} mm" for depth in depths)], lines)


def _fine_table(profiles: Mapping[str, Sequence[FineRow]]) -> str:
    pitches = dict.fromkeys(row.pitch_mm for rows in profiles.values() for row in rows)
    lines = []
    for question in FINE:
        for profile, rows in profiles.items():
            sizes = (finest(rows, pitch, question) for pitch in pitches)
            lines.append(
                [
                    question,
                    profile,
                    *("none" if size == math.inf else f"{size:g}" for size in sizes),
                ]
            )
    return markdown(["what", "method", *(f"pitch {pitch:g}" for pitch in pitches)], lines)


def _disturbed_table(profiles: Mapping[str, Sequence[DisturbedRow]]) -> str:
    kinds = dict.fromkeys(row.disturbance for rows in profiles.values() for row in rows)
    groups = [
        ((what, profile), [row for row in rows if row.disturbance == what])
        for what in kinds
        for profile, rows in profiles.items()
    ]
    return summary(("what", "method"), groups, DISTURBED)


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
