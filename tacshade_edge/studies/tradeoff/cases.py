"""The images that all settings reconstruct."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tacshade_edge.studies.cases import Case, calibrate_sensors, null_cases, press_cases
from tacshade_edge.studies.evaluate.scenes import DEPTHS_MM, RINGS, scenes
from tacshade_edge.studies.evaluate.sensors import PRESSES, REFERENCES, SensorName
from tacshade_edge.studies.parallel import Report, Workers, reported_map
from tacshade_edge.types import Calibration

NULL_FRAMES = 10
"""Number of frames without contact of each simulated sensor."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorCases:
    """All images of one sensor."""

    calibration: Calibration
    cases: tuple[Case, ...]


def simulated(
    sensors: Sequence[SensorName], objects: Sequence[str], workers: Workers, report: Report
) -> tuple[SensorCases, ...]:
    """Render every object at one place of each sensor (the next object at the next place) and three depths.

    Raises
    ------
    ConfigError
        A sensor cannot be calibrated.
    DeviceError
        A worker process was killed.
    """
    calibrations = calibrate_sensors(sensors, REFERENCES, PRESSES, workers, report)
    tasks = [(name, what, k) for name in sensors for k, what in enumerate((*objects, None))]
    found = list(reported_map(_cases, tasks, workers, report, "objects pressed"))
    count = len(objects) + 1
    return tuple(
        SensorCases(made.calibration, tuple(case for some in found[k * count : (k + 1) * count] for case in some))
        for k, made in enumerate(calibrations)
    )


def _cases(task: tuple[SensorName, str | None, int]) -> list[Case]:
    """Presses of one object, or frames without contact, on one sensor."""
    name, object_name, number = task
    sensor = name.make()
    if object_name is None:
        return list(null_cases(name, sensor, NULL_FRAMES))
    first = number % len(RINGS) * len(DEPTHS_MM)
    return list(press_cases(name, sensor, scenes(sensor.model, name.seed, object_name)[first : first + len(DEPTHS_MM)]))
