"""Families of simulated sensors beside the product's own, for studies; to import this makes their names known."""

from __future__ import annotations

import argparse

from tacshade_edge.cli.shared import study
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.studies.evaluate.sensors import FAMILIES, SensorName
from tools.testbed.simulator.other_family import OtherSensor, other_model

FINAL_SEED = 9000
"""Sensors from this seed on are for final figures; nobody looks at them while working on what is measured."""


def _usual(seed: int | None) -> SensorModel:
    return SensorModel() if seed is None else random_model(seed)


def other(seed: int | None) -> OtherSensor:
    """Never trained on."""
    return OtherSensor(other_model(seed or 0))


# One of its differences each.


def square(seed: int | None) -> OtherSensor:
    """The usual sensor on a square lattice."""
    return OtherSensor(_usual(seed), capped=False, two_scales=False)


def capped(seed: int | None) -> OtherSensor:
    """The usual skin with the other's mushroom pins."""
    return OtherSensor(other_model(seed or 0), square=False, two_scales=False)


def two_scales(seed: int | None) -> OtherSensor:
    """The usual print on the other's skin."""
    return OtherSensor(_usual(seed), square=False, capped=False)


FAMILIES.update({"other": other, "square": square, "capped": capped, "two-scales": two_scales})
FINAL_SENSORS = tuple(SensorName(family, FINAL_SEED + k) for family in ("tacshade", "other") for k in (18, 19, 20))


def sensor_name(text: str) -> SensorName:
    """Read ``[FAMILY:]SEED`` or ``default``. Raises ValueError."""
    return SensorName.parse(text)


def working_sensors(text: str) -> tuple[SensorName, ...]:
    """Read ``[FAMILY:]SEED,...``, for argparse; those kept for final figures are refused."""
    names = study.sensors(text)
    kept = [name for name in names if name.seed is not None and name.seed >= FINAL_SEED]
    if kept:
        raise argparse.ArgumentTypeError(f"{kept[0]}: seeds from {FINAL_SEED} on are kept for --final")
    return names
