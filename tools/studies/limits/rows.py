"""The results of the study of limits: each question has its own kind of row and its own CSV file."""

from __future__ import annotations

from dataclasses import dataclass

from tacshade_edge.reasons import text_of
from tacshade_edge.types import Reconstruction


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


def found(result: Reconstruction) -> tuple[str, bool, bool, bool, float, int, str]:
    """Return the fields of `Found`, which begin each row."""
    return (
        result.profile,
        result.valid,
        result.contact,
        result.saturated,
        result.depth_max_mm,
        len(result.objects),
        text_of(result.reason or result.degraded),
    )


@dataclass(frozen=True, slots=True)
class NullRow(Found):
    """A frame without contact, in which `contact` is a phantom."""

    sensor: str
    disturbance: str
    seed: int


@dataclass(frozen=True, slots=True)
class DepthRow(Found):
    """A press to a greatest h of `depth_mm`; `true_mm` is the greatest h of the simulated skin's grid.

    `faint` is true in the search for the least depth, and false in the one for the greatest.
    """

    sensor: str
    faint: bool
    object: str
    radius_mm: float
    depth_mm: float
    x_mm: float
    y_mm: float
    true_mm: float


@dataclass(frozen=True, slots=True)
class FineRow(Found):
    """Two bars with a gap (`size_mm`), or a ridge with a width (`size_mm`), on a sensor with a marker pitch.

    For bars, `true_height_mm` and `found_height_mm` are the dip of h between them; for a ridge, its greatest h.
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
    """A contact in a disturbed image. `clean_mm` is the depth from the same frame without the disturbance."""

    sensor: str
    disturbance: str
    seed: int
    x_mm: float
    y_mm: float
    true_mm: float
    clean_mm: float

    @property
    def off(self) -> float:
        """Relative difference between the depth and the undisturbed frame's; a lost contact counts as 1."""
        return abs(self.found_mm / self.clean_mm - 1)

    @property
    def silent(self) -> bool:
        """Whether nothing in the result warns a program to trust it less."""
        return self.valid and not self.doubt and not self.saturated
