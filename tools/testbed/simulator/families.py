"""More families of simulated sensors, for studies; importing this module registers their names."""

from __future__ import annotations

import argparse

from tacshade_edge.cli.shared import study
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.studies.evaluate.sensors import FAMILIES, SensorName
from tools.testbed.simulator.other_family import OtherSensor, other_model

FINAL_SEED = 9000
"""Sensors from this seed on are for final figures; nobody evaluates them while working on the measured code."""


def _usual(seed: int | None) -> SensorModel:
    return SensorModel() if seed is None else random_model(seed)


def other(seed: int | None) -> OtherSensor:
    """Make a sensor of the other family, on which no network was trained."""
    return OtherSensor(other_model(seed or 0))


# Each of these families has one of the other family's differences.


def square(seed: int | None) -> OtherSensor:
    """Make a usual sensor with a square lattice."""
    return OtherSensor(_usual(seed), capped=False, two_scales=False)


def capped(seed: int | None) -> OtherSensor:
    """Make a sensor with the usual skin and lattice, and the other family's mushroom pins."""
    return OtherSensor(other_model(seed or 0), square=False, two_scales=False)


def two_scales(seed: int | None) -> OtherSensor:
    """Make a sensor with the usual print on the other family's skin."""
    return OtherSensor(_usual(seed), square=False, capped=False)


FAMILIES.update({"other": other, "square": square, "capped": capped, "two-scales": two_scales})
FINAL_SENSORS = tuple(SensorName(family, FINAL_SEED + k) for family in ("tacshade", "other") for k in (21, 22, 23))


def sensor_name(text: str) -> SensorName:
    """Read ``[FAMILY:]SEED`` or ``default``. Raises ValueError."""
    return SensorName.parse(text)


def working_sensors(text: str) -> tuple[SensorName, ...]:
    """Read ``[FAMILY:]SEED,...``, for argparse; refuse sensors that are kept for final figures."""
    names = study.sensors(text)
    kept = [name for name in names if name.seed is not None and name.seed >= FINAL_SEED]
    if kept:
        raise argparse.ArgumentTypeError(f"{kept[0]}: seeds from {FINAL_SEED} on are kept for --final")
    return names
