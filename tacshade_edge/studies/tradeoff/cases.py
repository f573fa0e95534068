"""The images that all settings see, with their truth: simulated presses, rendered once, or a user's own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.studies.evaluate.own_images import read_images
from tacshade_edge.studies.evaluate.scenes import DEPTHS_MM, RINGS, null_images, scenes
from tacshade_edge.studies.evaluate.score import NOTHING, KnownTruth, Label
from tacshade_edge.studies.evaluate.sensors import SensorName, calibrated
from tacshade_edge.studies.parallel import Report, reported_map
from tacshade_edge.types import U8, Calibration

REFERENCES, PRESSES = 8, 40
"""What each simulated sensor is calibrated on."""

NULL_FRAMES = 10
"""Frames without contact of each simulated sensor."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """An image (uint8, H x W or H x W x 3) and what is known of it."""

    label: Label
    truth: KnownTruth
    image: U8

    @property
    def touched(self) -> bool:
        """Whether anything truly touches."""
        return len(self.truth.points_mm) > 0


@dataclass(frozen=True, slots=True, eq=False)
class SensorCases:
    """All images of one sensor."""

    calibration: Calibration
    cases: tuple[Case, ...]


def simulated(
    sensors: Sequence[SensorName], objects: Sequence[str], cores: int, report: Report
) -> tuple[SensorCases, ...]:
    """Every object at one place of each sensor (the next object at the next place) and three depths.

    Raises
    ------
    ConfigError
        A sensor cannot be calibrated.
    DeviceError
        A worker process was killed.
    """
    calibrations = list(reported_map(_calibration, sensors, cores, report, "sensors calibrated"))
    tasks = [(name, what, k) for name in sensors for k, what in enumerate((*objects, None))]
    found = list(reported_map(_cases, tasks, cores, report, "objects pressed"))
    count = len(objects) + 1
    return tuple(
        SensorCases(calibration, tuple(case for some in found[k * count : (k + 1) * count] for case in some))
        for k, calibration in enumerate(calibrations)
    )


def own(
    calibration: Calibration, sensor: str, images: Sequence[Path], report: Report, mistake: Callable[[str], None]
) -> SensorCases:
    """A user's images with the truth beside each; one that cannot be used is told to `mistake` in a line."""
    read = read_images(calibration, sensor, images, report, mistake)
    return SensorCases(calibration, tuple(Case(*each) for each in read))


def _calibration(name: SensorName) -> Calibration:
    return calibrated(name, REFERENCES, PRESSES).calibration


def _cases(task: tuple[SensorName, str | None, int]) -> list[Case]:
    """Presses of one object, or frames without contact, on one sensor."""
    name, object_name, number = task
    sensor = name.make()
    if object_name is None:
        nothing = KnownTruth(NOTHING, 0.0, None)
        return [
            Case(Label(str(name), "none", what), nothing, image) for what, image in null_images(sensor, NULL_FRAMES)
        ]
    cases = []
    place = number % len(RINGS)
    for scene in scenes(sensor.model, name.seed, object_name)[place * len(DEPTHS_MM) :][: len(DEPTHS_MM)]:
        frame = sensor.frame((scene.press,), scene.noise_seed)
        press = scene.press
        label = Label(str(name), object_name, "", press.depth_mm, press.x_mm, press.y_mm, press.rotation_deg)
        cases.append(Case(label, KnownTruth.of(frame.truth()), frame.image))
    return cases
