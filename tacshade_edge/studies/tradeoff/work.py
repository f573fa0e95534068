"""Measure what settings cost on this machine: memory in parallel, then time one by one."""

from __future__ import annotations

from collections.abc import Sequence

from tacshade_edge.studies.evaluate.score import Row
from tacshade_edge.studies.parallel import Report
from tacshade_edge.studies.tradeoff.cases import SensorCases
from tacshade_edge.studies.tradeoff.grid import Setting
from tacshade_edge.studies.tradeoff.memory import peak_memory
from tacshade_edge.studies.tradeoff.summary import Point, points
from tacshade_edge.studies.tradeoff.timing import time_settings

WEIGHED_IMAGES = 3


def weigh_and_time(
    settings: Sequence[Setting], sensors: Sequence[SensorCases], rows: Sequence[Sequence[Sequence[Row]]], report: Report
) -> tuple[tuple[Point, ...], float]:
    """Add memory and time on the first sensor's images, on this machine, to each setting's scores.

    Parameters
    ----------
    rows : sequence
        Rows of each setting, sensor and image (`score_settings`).

    Returns
    -------
    (tuple of Point, float)
        The points, and how busy the machine was (`time_settings`).

    Raises
    ------
    DeviceError
        A worker process was killed.
    """
    first = sensors[0]
    images = [case.image for case in first.cases if case.touched][:WEIGHED_IMAGES]
    peaks = peak_memory(settings, first.calibration, images, report)
    contact = [
        [case.image for case, row in zip(first.cases, some[0], strict=True) if row.contact and case.touched]
        for some in rows
    ]
    idle = [case.image for case in first.cases if not case.touched]
    times, busy = time_settings(settings, first.calibration, contact, idle, report)
    found = points(settings, [[row for of_sensor in some for row in of_sensor] for some in rows], times, peaks)
    return found, busy
