"""What the study of limits plans and finds: a row for each frame and profile."""

from __future__ import annotations

from dataclasses import dataclass

from tacshade_edge.lab.studies.evaluate.work import PRESSES, REFERENCES, SensorName
from tacshade_edge.reasons import text_of
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Frame, HeightMap

WRONG = 0.25
"""Relative error above which a depth counts as wrong."""


@dataclass(frozen=True, slots=True)
class Plan:
    """The parameters of a study.

    Lengths are in mm for every skin radius; depths are the skin's greatest h.
    """

    sensors: tuple[SensorName, ...]
    profiles: tuple[str, ...]
    references: int = REFERENCES
    presses: int = PRESSES
    null_frames: int = 1000  # without contact over all sensors, with the disturbances of normal use
    beyond_frames: int = 300  # with greater ones (`BEYOND`)
    ball_radii_mm: tuple[float, ...] = (3.0, 6.0, 9.0)
    faint_depths_mm: tuple[float, ...] = (
        0.1,
        0.15,
        0.2,
        0.25,
        0.3,
        0.35,
        0.4,
        0.5,
        0.6,
        0.8,
        1.0,
        1.5,
    )
    faint_places: int = 12  # of each sensor
    depths_mm: tuple[float, ...] = tuple(
        0.5 * k for k in range(1, 17)
    )  # of a ball of 6 mm and a cylinder
    deep_places: int = 8
    pitches_mm: tuple[float, ...] = (
        1.4,
        1.6,
        1.8,
        2.0,
        2.2,
        2.4,
    )  # with which the first sensor is printed again
    gaps_mm: tuple[float, ...] = (
        0.5,
        1.0,
        1.5,
        2.0,
        2.5,
        3.0,
        3.5,
        4.0,
        5.0,
        6.0,
    )  # between bars of `bar_width_mm`
    widths_mm: tuple[float, ...] = (0.4, 0.6, 0.8, 1.0, 1.5, 2.0, 3.0, 4.0)  # of a ridge
    bar_width_mm: float = 2.0
    fine_depth_mm: float = 2.5  # along z at the place
    fine_places: int = 6
    disturbed_places: int = 16  # contacts 2 mm deep for each disturbance and sensor


@dataclass(frozen=True, slots=True)
class Found:
    """A reconstruction without its maps. `doubt` is why it is invalid or degraded, or empty."""

    profile: str
    valid: bool
    contact: bool
    saturated: bool
    found_mm: float
    objects: int
    doubt: str


def found(
    made: Reconstructor, image: U8
) -> tuple[tuple[str, bool, bool, bool, float, int, str], HeightMap]:
    """The fields of `Found`, which begin each row, and the map."""
    result = made.step(Frame(0, 0, 0, image))
    doubt = text_of(result.reason or result.degraded)
    seen = (
        result.valid,
        result.contact,
        result.saturated,
        result.depth_max_mm,
        len(result.objects),
        doubt,
    )
    return (result.profile, *seen), result.height


@dataclass(frozen=True, slots=True)
class NullRow(Found):
    """A frame without contact, in which `contact` is a phantom."""

    sensor: str
    disturbance: str
    seed: int


@dataclass(frozen=True, slots=True)
class DepthRow(Found):
    """A press to a greatest h of `depth_mm`; `true_mm` is the greatest h
    of the simulated skin's grid.
    """

    sensor: str
    object: str
    radius_mm: float
    depth_mm: float
    x_mm: float
    y_mm: float
    true_mm: float


class FaintRow(DepthRow):
    """In the search for the least depth."""


class DeepRow(DepthRow):
    """In the search for the greatest depth."""


@dataclass(frozen=True, slots=True)
class FineRow(Found):
    """Two bars with a gap (`size_mm`), or a ridge with a width (`size_mm`),
    on a sensor with a marker pitch.

    For bars, `true_height_mm` and `found_height_mm` are the dip of h between them;
    for a ridge, its greatest h.
    """

    pitch_mm: float
    shape: str
    size_mm: float
    x_mm: float
    y_mm: float
    rotation_deg: float
    true_height_mm: float
    found_height_mm: float


@dataclass(frozen=True, slots=True)
class DisturbedRow(Found):
    """A contact in a disturbed image.

    `clean_mm` is the depth from the same frame without the disturbance.
    """

    sensor: str
    disturbance: str
    seed: int
    x_mm: float
    y_mm: float
    true_mm: float
    clean_mm: float

    @property
    def off(self) -> float:
        """Relative difference between the depth and the undisturbed frame's;
        a lost contact counts as 1.
        """
        return abs(self.found_mm / self.clean_mm - 1)

    @property
    def silently_wrong(self) -> bool:
        """Whether the contact is lost or has a wrong depth,
        and nothing warns a program to trust it less.
        """
        return self.off > WRONG and self.valid and not self.doubt and not self.saturated


KINDS = {
    "_nulls": NullRow,
    "_faint": FaintRow,
    "_deep": DeepRow,
    "_fine": FineRow,
    "_disturbed": DisturbedRow,
}
