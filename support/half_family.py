"""A family of one sensor whose camera has half the resolution,
so that a study on it takes seconds.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from support.calibrated_sensor import HALF
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.lab.studies.evaluate.work import FAMILIES, SensorName

HALF_SENSOR = SensorName("half", None)


@contextmanager
def half_family() -> Iterator[None]:
    """Register it, and keep to one core: another process would not know the family."""
    cores = os.sched_getaffinity(0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(FAMILIES, "half", lambda seed: SimulatedSensor(HALF))
        os.sched_setaffinity(0, {min(cores)})
        try:
            yield
        finally:
            os.sched_setaffinity(0, cores)
