"""The interface of all solvers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from tacshade_edge.core.depth.sigma import SigmaModel
from tacshade_edge.core.geometry.disc import Grid
from tacshade_edge.core.image.preprocess import Preprocessed, Preprocessor
from tacshade_edge.types import F32, Bool, freeze

Mark = Callable[[str], None]
"""Called with a stage's name at its end; a caller with a clock times the stages so."""


Features = list[F32]
"""Takes what a touch model looks at, network by network."""


@dataclass(frozen=True, slots=True, eq=False)
class Depth:
    """A solver's answer on its grid.

    Attributes
    ----------
    height_mm : float32 (rows, cols)
        h, finite and not below 0; outside the disc it says nothing.
    contact : bool (rows, cols) or None
        Where the skin touches an object, inside the disc only; None: to be found from the heights.
    saturated : bool
        Some cell left the range of the calibration.
    repaired_px : int
        Cells whose value was not finite and was replaced by 0.
    untrusted : bool (rows, cols) or None
        Where something else is shown than this sensor's skin; outside the disc it says nothing. None: not reported.
    contact_logit : float32 (rows, cols) or None
    untrusted_logit : float32 (M, M) or None
        Log odds of both, of untrusted for fewer and wider cells.
    """

    height_mm: F32
    contact: Bool | None = None
    saturated: bool = False
    repaired_px: int = 0
    untrusted: Bool | None = None
    contact_logit: F32 | None = None
    untrusted_logit: F32 | None = None

    def __post_init__(self) -> None:
        freeze(self, "height_mm")
        for name in ("contact", "untrusted", "contact_logit", "untrusted_logit"):
            if getattr(self, name) is not None:
                freeze(self, name)


@dataclass(frozen=True, slots=True, eq=False)
class NetworkMaps:
    """What a network makes of a frame.

    Attributes
    ----------
    depth_and_contact : float32 (2 fold², N, N)
    untrusted : float32 (M, M)
        Log odds that a cell, of fewer and wider ones, shows something else than the sensor's skin.
    """

    depth_and_contact: F32
    untrusted: F32


@dataclass(frozen=True, slots=True)
class ShearNetwork:
    """A network that finds how the skin moved along itself; see `Network`.

    Attributes
    ----------
    fold : int
    cells : int
        Along a side of the maps that it is given.
    sense : callable
    run : callable
        To the shear along x and y, (2, M, M).
    run_touch : callable or None
        To that and float32 (D,) of features for a touch model (`core.touch`).
    """

    fold: int
    cells: int
    sense: Callable[[F32], F32]
    run: Callable[[F32, F32], F32]
    run_touch: Callable[[F32, F32], tuple[F32, F32]] | None = None


@dataclass(frozen=True, slots=True)
class Network:
    """A network and how it wants its maps. N = cells / fold.

    Its first layer is linear in what it is given, so what a sensor's reference adds there is the same for every frame.

    Attributes
    ----------
    fold : int
        Each square of fold x fold cells makes as many channels (`learned.fold`).
    sense : callable
        What is known of a sensor, the reference's white folded and `learned.KNOWN` maps, (fold² + KNOWN, N, N), to what
        it adds to the first layer, (channels, N, N).
    run : callable
        A frame's white folded, (fold², N, N), and what `sense` gave, to `NetworkMaps`.
    shear : ShearNetwork
        Run beside it where shear is asked for.
    sigma : SigmaModel or None
        Its errors, where they were measured.
    run_touch : callable or None
        As `run`, and float32 (D,) of features for a touch model (`core.touch`).
    """

    fold: int
    sense: Callable[[F32], F32]
    run: Callable[[F32, F32], NetworkMaps]
    shear: ShearNetwork
    sigma: SigmaModel | None = None
    run_touch: Callable[[F32, F32], tuple[NetworkMaps, F32]] | None = None


class Solver(Protocol):
    """Depth from the preprocessed images of one sensor."""

    @property
    def grid(self) -> Grid:
        """Where its cells lie, in the camera's pixels."""
        ...

    @property
    def has_shear(self) -> bool:
        """Whether its `shear_mm` reports anything."""
        ...

    def solve(self, preprocessed: Preprocessed, mark: Mark, features: Features | None = None) -> Depth:
        """Solve for one image in contact; `mark` is for stages before the last, ``depth``, which the caller marks.

        Where `features` is given, those of its network are appended.
        """
        ...

    def shear_mm(self, preprocessed: Preprocessed, features: Features | None = None) -> F32 | None:
        """Shear along x and y of the skin at the grid's cells, float32 (rows, cols, 2); None: not reported.

        The caller's own; finite; outside the disc it says nothing. `features` as in `solve`.
        """
        ...


MakeSolver = Callable[[Preprocessor, Network | None], Solver]
"""Prepare a solver for what a preprocessor gives; the network is that of the profile, where it names one."""
