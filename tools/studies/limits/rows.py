"""What a study of limits finds: one kind of row for each question, a CSV file each."""

from __future__ import annotations

from dataclasses import dataclass

from tacshade_edge.reasons import text_of
from tacshade_edge.types import Reconstruction


@dataclass(frozen=True, slots=True)
class Found:
    """A reconstruction without its maps. `doubt` is its reason for refusal or for less trust, empty without."""

    profile: str
    valid: bool
    contact: bool
    saturated: bool
    found_mm: float
    objects: int
    doubt: str


def found(result: Reconstruction) -> tuple[str, bool, bool, bool, float, int, str]:
    """The fields of `Found`, to begin a row with."""
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
    """A frame with nothing touching; `contact` is a phantom."""

    sensor: str
    disturbance: str
    seed: int


@dataclass(frozen=True, slots=True)
class DepthRow(Found):
    """A press to a greatest h of `depth_mm`; `true_mm` is the greatest h of the simulated skin's grid.

    `faint`: of the search for the least depth, or of that for the greatest.
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
    """Two bars with a gap, or a ridge of a width, on a sensor of a pitch; a profile of h across their middle.

    For bars `true_height_mm` and `found_height_mm` are how much h dips between them, for a ridge its greatest h.
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
    """A contact in a disturbed image. `clean_mm` is what the same frame gave undisturbed."""

    sensor: str
    disturbance: str
    seed: int
    x_mm: float
    y_mm: float
    true_mm: float
    clean_mm: float

    @property
    def off(self) -> float:
        """How far the depth is from the undisturbed frame's, as a ratio; a lost contact is 1 off."""
        return abs(self.found_mm / self.clean_mm - 1)

    @property
    def silent(self) -> bool:
        """Nothing in the result tells a program to trust it less."""
        return self.valid and not self.doubt and not self.saturated
