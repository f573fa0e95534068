"""Score every setting on every image, over the machine's cores."""

from __future__ import annotations

from collections.abc import Sequence

from tacshade_edge.studies.evaluate.score import Row, score
from tacshade_edge.studies.parallel import Report, Workers, reported_map
from tacshade_edge.studies.tradeoff.cases import SensorCases
from tacshade_edge.studies.tradeoff.grid import Setting, make
from tacshade_edge.types import Frame


def score_settings(
    settings: Sequence[Setting], sensors: Sequence[SensorCases], workers: Workers, report: Report
) -> list[list[list[Row]]]:
    """Rows for each setting, sensor and image, nested in that order.

    Raises
    ------
    DeviceError
        A worker process was killed.
    """
    tasks = [(setting, each) for setting in settings for each in sensors]
    rows = list(reported_map(_rows, tasks, workers, report, "settings scored"))
    count = len(sensors)
    return [rows[k * count : (k + 1) * count] for k in range(len(settings))]


def _rows(task: tuple[Setting, SensorCases]) -> list[Row]:
    setting, sensor = task
    made = make(setting, sensor.calibration)
    return [score(case.label, case.truth, made.step(Frame(0, 0, 0, case.image))) for case in sensor.cases]
