"""The interface of the solvers that work on grey maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tacshade_edge.types import F32, Bool, freeze


@dataclass(frozen=True, slots=True, eq=False)
class GreyMaps:
    """What a solver works on: the maps of section IV-A and IV-B on one grid.

    Attributes
    ----------
    g, g0 : float32 (rows, cols), 0 to 255
        White ratio now and of the unloaded skin.
    g_d : float32 (rows, cols)
        Eq. 9, positive in contact.
    inside : bool (rows, cols)
    """

    g: F32
    g0: F32
    g_d: F32
    inside: Bool

    def __post_init__(self) -> None:
        freeze(self, "g", "g0", "g_d", "inside")


@dataclass(frozen=True, slots=True, eq=False)
class Depth:
    """A solver's answer.

    Attributes
    ----------
    height_mm : float32 (rows, cols)
        h, finite everywhere; outside the disc it says nothing.
    saturated : bool
        Some cell left the range of the calibration.
    repaired_px : int
        Cells whose value was not finite and was replaced by 0.
    """

    height_mm: F32
    saturated: bool
    repaired_px: int

    def __post_init__(self) -> None:
        freeze(self, "height_mm")


Solver = Callable[[GreyMaps, float], Depth]
"""Of the maps and α in mm: what a normalised height of 1 is."""
