"""Experiment 1: images of presses and of the untouched skin with their truth, their scores,
and the time they take.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain, cycle
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from tacshade_edge.calibration.calibrate import CalibrationResult, calibrate
from tacshade_edge.calibration.inputs import KnownPress, StatedSensor
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.images import read_image
from tacshade_edge.lab.parallel import Report, Workers, reported_map
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.simulator.script import ball_presses
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model
from tacshade_edge.lab.simulator.truth import SimulatedFrame, SimulatedSensor
from tacshade_edge.lab.studies.evaluate.score import (
    NOTHING,
    KnownTruth,
    Label,
    Row,
    read_truth,
    score,
)
from tacshade_edge.quoting import encodable
from tacshade_edge.sensor.inference.network import load_networks, make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Calibration, Frame

REFERENCES, PRESSES = 8, 40
"""Default numbers of images for calibrating a sensor."""

# Each image of a sensor has its own noise seed:
# references, presses, scenes, frames without contact.
REFERENCE_NOISE, PRESS_NOISE, SCENE_NOISE, NULL_NOISE = 1000, 2000, 3000, 4000


class PressedSensor(Protocol):
    """A sensor that a family makes from a seed."""

    model: SensorModel

    def frame(self, presses: Sequence[Press] = (), noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture."""
        ...


def tacshade(seed: int | None) -> SimulatedSensor:
    """Make a sensor of the simulator's own family."""
    return SimulatedSensor(SensorModel() if seed is None else random_model(seed))


FAMILIES: dict[str, Callable[[int | None], PressedSensor]] = {"tacshade": tacshade}
"""For each family, a module-level function that makes the sensor of a seed (None:
the default sensor).
"""


@dataclass(frozen=True, slots=True)
class SensorName:
    """The name of a reproducible sensor: its family,
    and its seed or None for the family's default.
    """

    family: str
    seed: int | None

    @classmethod
    def parse(cls, text: str) -> SensorName:
        """Read ``default``, ``SEED``, ``FAMILY:default`` or ``FAMILY:SEED``. Raises ValueError."""
        family, colon, seed = text.strip().rpartition(":")
        family = family if colon else "tacshade"
        if family not in FAMILIES:
            raise ValueError(
                f"no sensor family is called {family!r}, expected one of {', '.join(FAMILIES)}"
            )
        if seed == "default":
            return cls(family, None)
        # str.isdigit alone accepts digits of other scripts, and int a sign.
        if not (seed.isascii() and seed.isdigit() and len(seed) < 10):
            raise ValueError(f"found {seed!r}, expected a seed (a whole number) or default")
        return cls(family, int(seed))

    def __str__(self) -> str:
        """The text that `parse` reads."""
        seed = "default" if self.seed is None else str(self.seed)
        return seed if self.family == "tacshade" else f"{self.family}:{seed}"

    def make(self) -> PressedSensor:
        """Make the sensor."""
        return FAMILIES[self.family](self.seed)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the family too, because another process may not know it."""
        return _in_family, (self.family, self.seed, FAMILIES[self.family])


def family_of(sensor: str) -> str:
    """The family of a sensor, from its name's text."""
    return sensor.rpartition(":")[0] or "tacshade"


def _in_family(
    family: str, seed: int | None, make: Callable[[int | None], PressedSensor]
) -> SensorName:
    # A worker has imported only this module; its families come with the job.
    FAMILIES.setdefault(family, make)
    return SensorName(family, seed)


def calibrated(name: SensorName, references: int, presses: int) -> CalibrationResult:
    """Calibrate on references and known ball presses,
    using nothing of the model beyond its SENSOR.yaml.

    Raises ConfigError, which names the sensor, if it cannot be calibrated.
    """
    try:
        return calibrated_sensor(name.make(), name.seed or 0, references, presses)
    except ConfigError as error:
        raise ConfigError(f"sensor {name}: {error}") from None


def calibrated_sensor(
    sensor: PressedSensor, seed: int, references: int, presses: int
) -> CalibrationResult:
    """Calibrate a sensor without a name; its presses are drawn from the seed.

    Raises ConfigError.
    """
    model = sensor.model
    stated = StatedSensor(
        # What a user states too, and nothing else: the rest is found in the pictures.
        model.skin_radius_mm,
        model.camera_distance_mm,
        model.visible_half_angle_deg,
        "bright",
    )
    unloaded = [sensor.frame((), REFERENCE_NOISE + k).image for k in range(references)]
    pressed = [
        KnownPress(
            f"press {k}",
            sensor.frame((p,), PRESS_NOISE + k).image,
            radius,
            p.depth_mm,
            p.x_mm,
            p.y_mm,
        )
        for k, (p, radius) in enumerate(ball_presses(model, presses, seed))
    ]
    return calibrate(stated, unloaded, pressed, networks=load_networks())


def calibrate_sensors(
    sensors: Sequence[SensorName], references: int, presses: int, workers: Workers, report: Report
) -> list[CalibrationResult]:
    """Calibrate every sensor.

    Raises ConfigError (one cannot be calibrated) and DeviceError (a worker was killed).
    """
    job = partial(calibrated, references=references, presses=presses)
    return list(reported_map(job, sensors, workers, report, "sensors calibrated"))


def reconstructor(calibration: Calibration, profile: str) -> Reconstructor:
    """Make the reconstructor of a profile by name."""
    return make_reconstructor(calibration, PROFILES[profile])


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep OpenCV to one thread."""
    # As on a board, where other fingers have the other cores; and times do not depend on how many
    # there are.
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


# Around the 3 mm that objects are usually pressed, on a skin of 20 mm; the paper states no depth.
DEPTHS_MM = (1.5, 3.0, 4.5)
RINGS = ((0.0, 0.1), (0.2, 0.28), (0.32, 0.38))
"""Ranges of the distance from the tip, in skin radii:
in the middle, next to it, and well off it.
"""
NULL_FRAMES = 20


@dataclass(frozen=True, slots=True)
class Scene:
    """One press and the seed of its image's noise."""

    object_name: str
    press: Press
    noise_seed: int


def places(model: SensorModel, seed: int | None) -> list[tuple[float, float, float]]:
    """Draw x and y in mm and a rotation in degrees, one in each of `RINGS`;
    the same seed gives the same places.
    """
    # Places do not depend on the object, so that objects are compared at the same ones.
    rng = np.random.default_rng((0 if seed is None else seed + 1, 21))
    drawn = []
    for low, high in RINGS:
        rho, angle = model.skin_radius_mm * rng.uniform(low, high), rng.uniform(0, 2 * math.pi)
        turn = rng.uniform(0, 360)
        drawn.append(
            (round(rho * math.cos(angle), 3), round(rho * math.sin(angle), 3), round(turn, 1))
        )
    return drawn


def scenes(
    model: SensorModel, seed: int | None, object_name: str, depths_mm: Sequence[float] = DEPTHS_MM
) -> list[Scene]:
    """Scenes of one object at every place and depth;
    the object scales with the skin radius relative to 20 mm.
    """
    scale = model.skin_radius_mm / 20
    shape = OBJECTS[object_name]()
    grid = [(place, depth) for place in places(model, seed) for depth in depths_mm]
    return [
        Scene(object_name, Press(shape, x, y, depth, turn, scale), SCENE_NOISE + k)
        for k, ((x, y, turn), depth) in enumerate(grid)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """An image (uint8, H x W or H x W x 3) with its label and ground truth."""

    label: Label
    truth: KnownTruth
    image: U8

    @property
    def touched(self) -> bool:
        """Whether anything truly touches."""
        return len(self.truth.points_mm) > 0


def press_cases(name: SensorName, sensor: PressedSensor, scenes: Iterable[Scene]) -> Iterator[Case]:
    """Yield a picture of each scene with its ground truth."""
    for scene in scenes:
        press, frame = scene.press, sensor.frame((scene.press,), scene.noise_seed)
        label = Label(
            str(name),
            scene.object_name,
            "",
            press.depth_mm,
            press.x_mm,
            press.y_mm,
            press.rotation_deg,
        )
        yield Case(label, KnownTruth.of(frame.truth()), frame.image)


def null_cases(name: SensorName | str, sensor: PressedSensor, count: int) -> Iterator[Case]:
    """Yield pictures of the untouched skin as from a sensor in use:
    in turn unchanged, in other light, and shifted.
    """
    # What a sensor in use goes through: LEDs age and warm up, a camera shifts in its seat.
    changes: dict[str, Callable[[U8], U8]] = {
        "": lambda image: image,
        "light x0.8": lambda image: camera_faults.gain(image, 0.8),
        "light x1.2": lambda image: camera_faults.gain(image, 1.2),
        "a row down": lambda image: camera_faults.shift(image, 1, 0),
        "a column right": lambda image: camera_faults.shift(image, 0, 1),
    }
    for k, what in zip(range(count), cycle(changes)):
        image = changes[what](sensor.frame((), NULL_NOISE + k).image)
        yield Case(Label(str(name), "none", what), KnownTruth(NOTHING, 0.0, None), image)


def evaluate(
    sensors: Sequence[SensorName],
    profiles: Sequence[str],
    objects: Sequence[str],
    workers: Workers,
    report: Report,
    *,
    references: int = REFERENCES,
    presses: int = PRESSES,
    depths_mm: Sequence[float] = DEPTHS_MM,
    null_frames: int = NULL_FRAMES,
) -> tuple[list[Row], list[CalibrationResult]]:
    """A row for each frame and profile, and each sensor's calibration;
    the same again for the same values.

    Raises ConfigError (a sensor cannot be calibrated) and DeviceError (a worker was killed).
    """
    found = calibrate_sensors(sensors, references, presses, workers, report)
    tasks = [
        (name, made.calibration, what)
        for name, made in zip(sensors, found, strict=True)
        for what in (*objects, None)
    ]
    # A job is one object on one sensor, whose pictures are drawn once for all profiles.
    job = partial(_rows, tuple(profiles), depths_mm, null_frames)
    return list(
        chain.from_iterable(reported_map(job, tasks, workers, report, "objects pressed"))
    ), found


def _rows(
    profiles: Sequence[str],
    depths_mm: Sequence[float],
    null_frames: int,
    task: tuple[SensorName, Calibration, str | None],
) -> list[Row]:
    """Score every profile on every press of one object on one sensor,
    or on frames without contact.
    """
    name, calibration, object_name = task
    sensor = name.make()
    cases = (
        null_cases(name, sensor, null_frames)
        if object_name is None
        else press_cases(name, sensor, scenes(sensor.model, name.seed, object_name, depths_mm))
    )
    return score_cases(calibration, profiles, cases)


def score_cases(
    calibration: Calibration, profiles: Sequence[str], cases: Iterable[Case]
) -> list[Row]:
    """Score images one after another in this process."""
    # Once for all cases: to load the networks takes longer than a frame.
    made = [reconstructor(calibration, profile) for profile in profiles]
    return [
        score(case.label, case.truth, each.step(Frame(0, 0, 0, case.image)))
        for case in cases
        for each in made
    ]


def read_images(
    calibration: Calibration,
    sensor: str,
    images: Sequence[Path],
    report: Report,
    mistake: Callable[[str], None],
) -> Iterator[Case]:
    """Yield images with their ground truth; report an unusable one to `mistake` in one line
    and continue.
    """
    size = (calibration.image_height_px, calibration.image_width_px)
    for k, path in enumerate(images):
        report("images", k, len(images))
        try:
            image = read_image(path)
            if image.shape[:2] != size:
                found, expected = (
                    f"{width}x{height} px" for height, width in (image.shape[:2], size)
                )
                raise DecodeError(
                    f"{path}: found {found}, expected {expected}, "
                    "the size of the calibration's images"
                )
            truth, name = read_truth(path.with_suffix(".npz"), size, calibration.geometry)
        except DecodeError as error:
            # One bad picture of a hundred must not lose the others.
            mistake(str(error))
            continue
        yield Case(
            Label(sensor, name if len(truth.points_mm) else "none", encodable(path.name)),
            truth,
            image,
        )
    report("images", len(images), len(images))
