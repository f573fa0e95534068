"""What every family's sensor gives: pictures of its untouched and touched skin,
and presses with their truth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from tacshade_edge.calibration.calibrate import CalibrationResult, calibrate
from tacshade_edge.calibration.inputs import KnownPress, StatedSensor
from tacshade_edge.lab.studies.evaluate.score import KnownTruth
from tacshade_edge.sensor.inference.network import load_networks
from tacshade_edge.types import U8

REFERENCES, TOUCHES, BALLS = 5, 20, 40
"""Pictures of the untouched skin, unlabelled touches and ball presses that a user takes."""
TOUCH_NOISE = 5000
"""The seed of the first touch's noise; the others are those of `lab.studies.evaluate.work`."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A picture of an object, pressed or pressed and dragged;
    `truth` has the true heights too, in mm.
    """

    object_name: str
    dragged: bool
    image: U8
    truth: KnownTruth


class Stranger(Protocol):
    """One sensor of a family."""

    @property
    def stated(self) -> StatedSensor:
        """What its user writes into SENSOR.yaml."""

    def references(self, count: int = REFERENCES) -> list[U8]:
        """Take pictures of the untouched skin."""

    def touches(self, count: int = TOUCHES) -> list[U8]:
        """Take pictures of objects that touch it, mixed. Raises FileNotFoundError (not solved)."""

    def balls(self, count: int = BALLS) -> Sequence[KnownPress]:
        """Press balls, with errors in the stated places and depths.

        Raises FileNotFoundError (not solved).
        """

    def judged(self) -> Iterator[Seen]:
        """Press and drag Table I's objects. Raises FileNotFoundError (not solved)."""


def calibrated(stranger: Stranger, presses: Sequence[KnownPress] = ()) -> CalibrationResult:
    """Calibrate a sensor as its user does, without a fit. Raises ConfigError."""
    return calibrate(
        stranger.stated, stranger.references(), list(presses), networks=load_networks()
    )
