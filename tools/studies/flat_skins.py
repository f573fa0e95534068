#!/usr/bin/env python3
"""What the shipped networks make of flat skins, and what a wrongly stated form costs.

::

    .venv/bin/python -m tools.studies.flat_skins [--sensors 31,32 | --final] [--half-angles 0 10 20]

Each sensor of the TacShade family is flattened: to a pad (half angle 0) or to a dome with the same
visible circle, as far from the lens. It is calibrated on references alone, stated as it is and as
the dome that it was before. "Ratio" is the geometric mean of found over true height in the contact,
after the division by `sensor.depth.learned.shown_ratio`.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel, flattened, random_model
from tacshade_edge.lab.simulator.truth import SimulatedFrame, SimulatedSensor, Truth
from tacshade_edge.lab.studies.evaluate.score import score_cloud
from tacshade_edge.lab.studies.evaluate.work import SensorName, reconstructor
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.types import Frame, Geometry, HeightMap
from tools.testbed.simulator.families import FINAL_SENSORS, working_sensors

PROFILES = ("paper", "fast", "balanced", "accurate")
SENSORS = "31,32,33,34"
FINAL = tuple(name for name in FINAL_SENSORS if name.family == "tacshade")[:4]
OBJECTS_OF = {"ball": "ball", "flat": "cylinder", "cube": "cube"}
DEPTHS_MM, REFERENCES, FREE = (1.0, 2.0, 3.5), 5, 5
FARTHEST = 0.45
"""Of the visible circle: the places of presses."""
COLUMNS = (
    "half angle",
    "stated",
    "profile",
    "ME mm",
    "missed",
    "depth error",
    "of balls",
    "of flats",
    "ratio",
    "spread",
    "phantoms",
)


@dataclass(frozen=True, slots=True)
class Row:
    """How a profile fares on a frame; NaN for a missed press."""

    half_angle_deg: float
    stated: str
    profile: str
    object: str
    contact: bool
    me_mm: float = math.nan
    depth_off_mm: float = math.nan
    log_ratio: float = math.nan


def formed(model: SensorModel, half_angle_deg: float) -> SensorModel:
    """The sensor on a skin of another half angle, with its visible circle and lens; 0: a pad."""
    flat = flattened(model)
    if not half_angle_deg or flat.camera_distance_mm is None:
        return flat
    half = math.radians(half_angle_deg)
    r = flat.geometry.visible_radius_mm / math.sin(half)
    d = flat.camera_distance_mm - r * math.cos(half)
    return replace(
        flat,
        skin="dome",
        skin_radius_mm=r,
        visible_half_angle_deg=half_angle_deg,
        camera_distance_mm=d,
    )


def frames(model: SensorModel, scale: float, seed: int) -> Iterator[tuple[str, SimulatedFrame]]:
    """Presses of every object and depth, and free frames, with the names of the objects."""
    sensor, random = SimulatedSensor(model), np.random.default_rng((seed, 62))
    reach_mm = FARTHEST * model.geometry.visible_radius_mm
    for k, (name, depth_mm) in enumerate(product(OBJECTS_OF, DEPTHS_MM)):
        rho_mm, angle = reach_mm * math.sqrt(random.uniform()), random.uniform(0, 2 * math.pi)
        place = rho_mm * math.cos(angle), rho_mm * math.sin(angle)
        shape, turn_deg = OBJECTS[OBJECTS_OF[name]](), random.uniform(0, 360)
        press = Press(shape, *place, scale * depth_mm, turn_deg, scale)
        yield name, sensor.frame((press,), 1000 + k)
    for k in range(FREE):
        yield "none", sensor.frame((), 2000 + k)


def rows(name: SensorName, half_angle_deg: float, profiles: Sequence[str]) -> Iterator[Row]:
    """The rows of one sensor in one form."""
    base = random_model(name.seed or 0, 240, 320)
    model = formed(base, half_angle_deg)
    references = [SimulatedSensor(model).frame((), k).image for k in range(REFERENCES)]
    known = base.geometry
    sensor = StatedSensor(
        known.skin_radius_mm, known.camera_distance_mm, known.visible_half_angle_deg, "bright"
    )
    found = calibrate(sensor, references).calibration  # of the picture, whatever is stated
    truly = replace(model.geometry, disc=found.geometry.disc)
    stated = {"as it is": replace(found, geometry=truly), "as the dome": found}
    made = {
        (words, profile): reconstructor(calibration, profile)
        for words, calibration in stated.items()
        for profile in profiles
    }
    for what, frame in frames(model, base.skin_radius_mm / 20, name.seed or 0):
        truth = frame.truth()
        for (words, profile), one in made.items():
            result = one.step(Frame(0, 0, 0, frame.image))
            row = Row(half_angle_deg, words, profile, what, contact=result.contact)
            if what != "none" and result.contact:
                shift_mm = foot_mm(one.calibration.geometry) - foot_mm(model.geometry)
                points = (result.cloud.points_mm - (0, 0, shift_mm)).astype(np.float32)
                row = replace(
                    row,
                    me_mm=score_cloud(points, truth.points_mm, truth.depth_max_mm).me_mm,
                    depth_off_mm=result.depth_max_mm - truth.depth_max_mm,
                    log_ratio=log_ratio(result.height, truth),
                )
            yield row


def foot_mm(geometry: Geometry) -> float:
    """The z of the visible circle, which is one circle for every form that is stated."""
    if geometry.skin == "pad":
        return 0.0
    return geometry.skin_radius_mm * math.cos(math.radians(geometry.visible_half_angle_deg))


def log_ratio(height: HeightMap, truth: Truth) -> float:
    """Logarithm of found over true mean height at the cells of the true contact."""
    i, j = np.mgrid[: height.height_mm.shape[0], : height.height_mm.shape[1]]
    rows, cols = (
        np.clip(np.rint(first + each * height.step_px).astype(int), 0, size - 1)
        for first, each, size in zip(
            (height.row0, height.col0), (i, j), truth.contact.shape, strict=True
        )
    )
    true_mm = truth.height_mm[rows, cols]
    use = truth.contact[rows, cols] & np.isfinite(height.height_mm) & np.isfinite(true_mm)
    return math.log(max(float(height.height_mm[use].mean()), 1e-3) / float(true_mm[use].mean()))


def line(some: Sequence[Row]) -> tuple[str, ...]:
    """The figures of a form, statement and profile."""
    first, pressed = some[0], [row for row in some if row.object != "none"]
    seen = [row for row in pressed if row.contact]

    def error(name: str) -> str:
        return f"{np.mean([abs(row.depth_off_mm) for row in seen if name in ('', row.object)]):.2f}"

    logs = [row.log_ratio for row in seen]
    return (
        f"{first.half_angle_deg:g}°",
        first.stated,
        first.profile,
        f"{np.mean([row.me_mm for row in seen]):.3f}",
        f"{len(pressed) - len(seen)} of {len(pressed)}",
        error(""),
        error("ball"),
        error("flat"),
        f"{math.exp(np.mean(logs)):.2f}",
        f"{np.std(logs):.2f}",
        f"{sum(row.contact for row in some if row.object == 'none')} of {len(some) - len(pressed)}",
    )


def main(words: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--sensors", type=working_sensors, default=working_sensors(SENSORS))
    which.add_argument("--final", dest="sensors", action="store_const", const=FINAL)
    parser.add_argument("--half-angles", type=float, nargs="+", default=[0.0], metavar="DEG")
    parser.add_argument("--profile", nargs="+", choices=PROFILES, default=PROFILES)
    args = parser.parse_args(words)
    cv2.setNumThreads(1)
    table = []
    for half_angle_deg in args.half_angles:
        found = [row for name in args.sensors for row in rows(name, half_angle_deg, args.profile)]
        groups: dict[tuple[str, str], list[Row]] = {}
        for row in found:
            groups.setdefault((row.stated, row.profile), []).append(row)
        table += [line(some) for _, some in sorted(groups.items())]
    print(markdown(COLUMNS, table))


if __name__ == "__main__":
    main()
