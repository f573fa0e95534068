#!/usr/bin/env python3
"""What the judges of a frame refuse, and take from a network, on simulated sensors of all kinds.

::

    .venv/bin/python -m tools.studies.judges --sensors tacshade:4,other:5,tactip:6 --frames 20

Each kind has as many frames of each sensor: presses, nothing in contact under every change of
normal use, and images that show no skin as it is. A network overruled is one that found a contact
of `LEAST_MM` or more in a frame for which the gate or a judge answers that there is none. The
second table has each figure of a judge: its limit, how far frames of normal use go, and the nearest
frame that it refuses.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.doctor.judged_pictures import limits_of
from tacshade_edge.lab.parallel import reported_map, workers
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.simulator.sensor_model import random_model, tactip
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.lab.studies.evaluate.work import (
    FAMILIES,
    PressedSensor,
    SensorName,
    reconstructor,
)
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.contact.objects import contact_of, find_objects
from tacshade_edge.sensor.frame_check import Measured
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Calibration, Frame, Polarity, Reconstruction
from tools.studies.disturbances import BEYOND, CHANGES, RELEASED, without_contact
from tools.testbed.simulator.families import working_sensors

LEAST_MM = 0.3
REFERENCES = 8
SENSORS = "default,5,11,other:5,other:6,tactip:7,tactip:8,square:9"


def _tactip(seed: int | None) -> SimulatedSensor:
    return SimulatedSensor(tactip(random_model(seed or 0)))


FAMILIES["tactip"] = _tactip

Rng = np.random.Generator


@dataclass(frozen=True, slots=True)
class Seen:
    """The result of a frame, and the greatest h that the network found by itself (0:
    no contact).
    """

    code: str
    degraded: bool
    contact: bool
    depth_mm: float
    found_mm: float

    @property
    def overruled(self) -> bool:
        """Whether the gate or a judge says no where the network finds a contact."""
        return not self.contact and self.found_mm >= LEAST_MM


def press_of(sensor: PressedSensor, rng: Rng) -> Press:
    """Draw a press of any object, half of them at most 1 mm deep, a third of them dragged."""
    scale = sensor.model.skin_radius_mm / 20
    rho, angle = 9 * scale * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
    depth = float(rng.uniform(0.2, 1.0) if rng.random() < 0.5 else rng.uniform(1.0, 5.5))
    drag = rng.normal(0, 0.4 * depth, 2) if rng.random() < 1 / 3 else np.zeros(2)
    return Press(
        OBJECTS[list(OBJECTS)[rng.integers(len(OBJECTS))]](),
        rho * math.cos(angle),
        rho * math.sin(angle),
        depth * scale,
        rotation_deg=float(rng.uniform(0, 360)),
        scale=scale,
        drag_x_mm=float(drag[0]) * scale,
        drag_y_mm=float(drag[1]) * scale,
    )


def _specks(image: U8, sensor: PressedSensor, rng: Rng) -> U8:
    model, count = sensor.model, int(rng.integers(1, 6))
    for _ in range(count):
        rho, angle = model.disc_radius_px * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
        row, col = model.row_c + rho * math.sin(angle), model.col_c + rho * math.cos(angle)
        image = camera_faults.speck(
            image, row, col, float(rng.uniform(0.05, 0.35)) * model.disc_radius_px
        )
    return image


def _foreign(image: U8, sensor: PressedSensor, rng: Rng) -> U8:
    """A picture of something else: a blurred scene, patches, stripes, coarse noise."""
    shape, kind = image.shape[:2], int(rng.integers(4))
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    if kind == 0:
        scene = cv2.GaussianBlur(rng.normal(128, 60 * 30, shape).astype(np.float32), (0, 0), 30)
    elif kind == 1:
        small = rng.uniform(0, 255, (6, 8)).astype(np.float32)
        scene = cv2.resize(small, shape[::-1], interpolation=cv2.INTER_NEAREST)
    elif kind == 2:
        scene = 128 + 100 * np.sin(
            (rows * rng.uniform(-1, 1) + cols * rng.uniform(-1, 1)) * rng.uniform(0.05, 0.6)
        )
    else:
        scene = cv2.resize(rng.uniform(0, 255, (60, 80)).astype(np.float32), shape[::-1])
    grey = np.clip(scene, 0, 255).astype(np.uint8)
    return grey if image.ndim == 2 else cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)


def _other_sensor(image: U8, sensor: PressedSensor, rng: Rng) -> U8:
    """Another sensor's free skin at this one's place."""
    other = SimulatedSensor(random_model(int(rng.integers(100, 104))))
    frame, theirs, ours = other.frame((), 1).image, other.model, sensor.model
    zoom = ours.disc_radius_px / theirs.disc_radius_px
    matrix = np.array(
        ((zoom, 0, ours.col_c - zoom * theirs.col_c), (0, zoom, ours.row_c - zoom * theirs.row_c))
    )
    turned = cv2.getRotationMatrix2D((ours.col_c, ours.row_c), float(rng.uniform(0, 360)), 1.0)
    whole = turned @ np.vstack((matrix, (0, 0, 1)))
    return np.asarray(cv2.warpAffine(frame, whole, image.shape[1::-1]), np.uint8)


def _black(image: U8, sensor: PressedSensor, rng: Rng) -> U8:
    return np.asarray(rng.integers(0, int(rng.integers(2, 9)), image.shape), np.uint8)


def _white(image: U8, sensor: PressedSensor, rng: Rng) -> U8:
    return np.asarray(np.clip(image.astype(np.float32) * rng.uniform(3.5, 8), 0, 255), np.uint8)


def _covered(image: U8, sensor: PressedSensor, rng: Rng) -> U8:
    """Half of the lens covered."""
    made, model = image.copy(), sensor.model
    angle = rng.uniform(0, 2 * math.pi)
    rows, cols = np.ogrid[: image.shape[0], : image.shape[1]]
    beyond = (rows - model.row_c) * math.sin(angle) + (cols - model.col_c) * math.cos(angle)
    made[beyond > rng.uniform(-0.5, 0.5) * model.disc_radius_px] = int(rng.integers(0, 60))
    return made


SPOILT: dict[str, Callable[[U8, PressedSensor, Rng], U8]] = {
    "black": _black,
    "white": _white,
    "foreign: no skin": _foreign,
    "foreign: another sensor": _other_sensor,
    "dirty: specks": _specks,
    "dirty: half covered": _covered,
}
PRESSED = "pressed"
USUAL = (PRESSED, *CHANGES, RELEASED)
"""The kinds of frames of normal use."""


def frames(sensor: PressedSensor, seed: int, count: int) -> Iterator[tuple[str, U8]]:
    """`count` frames of each kind, each with the name of its kind;
    five times as many presses and releases.
    """
    for k in range(5 * count):
        rng = np.random.default_rng((seed, 51, k))
        yield PRESSED, sensor.frame((press_of(sensor, rng),), 6000 + k).image
    for what in (*CHANGES, RELEASED, *BEYOND):
        for k in range(count * (5 if what == RELEASED else 1)):
            yield what, without_contact(sensor, what, 1000 * seed + k, 7000 + k)
    for what, spoil in SPOILT.items():
        for k in range(count):
            yield (
                what,
                spoil(
                    sensor.frame((), 8000 + k).image, sensor, np.random.default_rng((seed, 52, k))
                ),
            )
    for what, change in BEYOND.items():
        for k in range(count):
            rng = np.random.default_rng((seed, 53, k))
            image = sensor.frame((press_of(sensor, rng),), 9000 + k).image
            yield f"pressed, {what}", change(image, sensor.model, rng)


def calibrated(sensor: PressedSensor) -> Calibration:
    """From references alone."""
    model = sensor.model
    polarity: Polarity = "dark" if model.pin_tip_reflectance > 0.5 else "bright"
    stated = StatedSensor(
        model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, polarity
    )
    return calibrate(stated, [sensor.frame((), k).image for k in range(REFERENCES)]).calibration


def seen(one: Reconstructor, image: U8, made: Reconstruction) -> Seen:
    """What a profile answered, and what its network finds if it is asked."""
    found_mm = made.depth_max_mm
    if not made.contact and one.profile.network is not None:
        depth, inside = one.depth(image), one.rays.inside
        height = np.where(inside, depth.height_mm, np.float32(np.nan))
        objects = find_objects(
            contact_of(depth, inside), height, None, one.rays, one.calibration.geometry
        )
        found_mm = float(np.max(height[objects.contact])) if objects else 0.0
    code = made.reason.code.value if made.reason else ""
    return Seen(code, made.degraded is not None, made.contact, made.depth_max_mm, found_mm)


def row(what: str, by_profile: Sequence[Sequence[Seen]]) -> tuple[str, ...]:
    """The counts of one kind, a number for each profile."""

    def each(count: Callable[[Sequence[Seen]], object]) -> str:
        return ", ".join(str(count(some)) for some in by_profile)

    by = Counter(one.code for some in by_profile for one in some if one.code)
    return (
        what,
        str(len(by_profile[0])),
        each(lambda some: sum(bool(one.code) for one in some)),
        ", ".join(code for code, _ in by.most_common()) or "-",
        each(lambda some: sum(one.contact for one in some)),
        each(lambda some: sum(one.contact and not one.degraded for one in some)),
        each(lambda some: f"{max(one.depth_mm for one in some):.2f}"),
        each(lambda some: sum(one.overruled for one in some)),
    )


class Margins:
    """How near to each limit frames of normal use and refused frames come."""

    def __init__(self) -> None:
        self._usual: dict[tuple[str, str], list[Measured]] = {}
        self._refused: dict[tuple[str, str], list[Measured]] = {}

    def add(self, measured: Iterable[Measured], *, usual: bool) -> None:
        """Count a frame's figures: of normal use, or else those that refuse it."""
        for each in measured:
            if usual or each.refuses:
                to = self._usual if usual else self._refused
                to.setdefault((each.judge, each.what), []).append(each)

    def join(self, other: Margins) -> None:
        """Add the frames of another sensor."""
        for ours, theirs in ((self._usual, other._usual), (self._refused, other._refused)):
            for key, some in theirs.items():
                ours.setdefault(key, []).extend(some)

    def rows(self, near_only: bool = False) -> list[tuple[str, ...]]:
        """A row for each figure: its limits, and the extremes of both kinds of frames on the side
        of the limit; with `near_only` only for those that come within half of their limit.
        """
        made: list[tuple[str, ...]] = []
        for key in dict.fromkeys((*self._usual, *self._refused)):
            usual, refused = self._usual.get(key, []), self._refused.get(key, [])
            one = (usual or refused)[0]
            far, near = (max, min) if math.isfinite(one.most) else (min, max)
            reach = far(each.found for each in usual) if usual else math.nan
            if near_only and not (
                reach > one.most / 2 if math.isfinite(one.most) else reach < one.least * 2
            ):
                continue
            made.append(
                (
                    *key,
                    limits_of(one.least, one.most),
                    f"{reach:.3g}" if usual else "-",
                    f"{near(each.found for each in refused):.3g}" if refused else "-",
                    str(len(refused)),
                )
            )
        return made


MARGINS = (
    "judge",
    "figure",
    "limit",
    "normal use reaches",
    "nearest refused",
    "frames refused by it",
)
COLUMNS = (
    "what",
    "count",
    "refused",
    "by",
    "contacts",
    "not degraded",
    "deepest mm",
    "network overruled",
)


def judged(
    task: tuple[SensorName, Sequence[str], int],
) -> tuple[dict[tuple[str, str], list[Seen]], Margins]:
    """All frames of a sensor, by kind and profile."""
    name, profiles, count = task
    rows: dict[tuple[str, str], list[Seen]] = {}
    margins, sensor = Margins(), name.make()
    made = {profile: reconstructor(calibrated(sensor), profile) for profile in profiles}
    for what, image in frames(sensor, name.seed or 0, count):
        for profile, one in made.items():
            rows.setdefault((what, profile), []).append(
                seen(one, image, one.step(Frame(0, 0, 0, image)))
            )
            margins.add(one.measured(image), usual=what in USUAL)
    return rows, margins


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--sensors", type=working_sensors, default=working_sensors(SENSORS), metavar="SEED,..."
    )
    parser.add_argument(
        "--profile", nargs="+", choices=PROFILES, default=("fast", "balanced", "accurate")
    )
    parser.add_argument(
        "--frames", type=int, default=10, metavar="N", help="of each kind and sensor (10)"
    )
    args = parser.parse_args()
    cv2.setNumThreads(1)
    rows: dict[tuple[str, str], list[Seen]] = {}
    margins = Margins()
    tasks = [(name, args.profile, args.frames) for name in args.sensors]
    with workers() as pool:
        for some, near in reported_map(judged, tasks, pool, Progress(), "sensors"):
            for key, found in some.items():
                rows.setdefault(key, []).extend(found)
            margins.join(near)
    whole = [[one for what in USUAL for one in rows[what, profile]] for profile in args.profile]
    table = [row("normal use", whole)]
    table += [
        row(what, [rows[what, each] for each in args.profile])
        for what in dict.fromkeys(what for what, _ in rows)
    ]
    print(f"Each number of three: {', '.join(args.profile)}\n\n{markdown(COLUMNS, table)}")
    print("\nThe limits of the judges\n\n" + markdown(MARGINS, margins.rows()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
