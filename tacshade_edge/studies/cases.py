"""Images with ground truth: presses of simulated sensors, and frames without contact."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from tacshade_edge.core.calibration.calibrate import CalibrationResult
from tacshade_edge.studies.evaluate.scenes import Scene, null_images
from tacshade_edge.studies.evaluate.score import NOTHING, KnownTruth, Label
from tacshade_edge.studies.evaluate.sensors import PressedSensor, SensorName, calibrated
from tacshade_edge.studies.parallel import Report, Workers, reported_map
from tacshade_edge.types import U8


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


def calibrate_sensors(
    sensors: Sequence[SensorName], references: int, presses: int, workers: Workers, report: Report
) -> list[CalibrationResult]:
    """Calibrate every sensor. Raises ConfigError (one cannot be calibrated) and DeviceError (a worker was killed)."""
    tasks = [(name, references, presses) for name in sensors]
    return list(reported_map(_calibrated, tasks, workers, report, "sensors calibrated"))


def _calibrated(task: tuple[SensorName, int, int]) -> CalibrationResult:
    return calibrated(*task)


def press_label(name: SensorName, scene: Scene) -> Label:
    """The label of a simulated press."""
    press = scene.press
    return Label(str(name), scene.object_name, "", press.depth_mm, press.x_mm, press.y_mm, press.rotation_deg)


def press_cases(name: SensorName, sensor: PressedSensor, scenes: Iterable[Scene]) -> Iterator[Case]:
    """Yield a picture of each scene with its ground truth."""
    for scene in scenes:
        frame = sensor.frame((scene.press,), scene.noise_seed)
        yield Case(press_label(name, scene), KnownTruth.of(frame.truth()), frame.image)


def null_cases(name: SensorName, sensor: PressedSensor, count: int) -> Iterator[Case]:
    """Yield pictures of the untouched skin (`null_images`)."""
    nothing = KnownTruth(NOTHING, 0.0, None)
    for what, image in null_images(sensor, count):
        yield Case(Label(str(name), "none", what), nothing, image)
