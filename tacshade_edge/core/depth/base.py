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
"""Called with a stage's name at its end, so that a caller with a clock can time it."""


Features = list[F32]
"""Collects the features for a touch model, network by network."""


@dataclass(frozen=True, slots=True, eq=False)
class Depth:
    """A solver's answer on its grid.

    Attributes
    ----------
    height_mm : float32 (rows, cols)
        Height h, finite and not below 0; undefined outside the disc.
    contact : bool (rows, cols) or None
        Cells where the skin touches an object, inside the disc only; None if only the heights show it.
    saturated : bool
        Whether some cell left the range of the calibration.
    repaired_px : int
        Number of cells with a value that was not finite, replaced by 0.
    untrusted : bool (rows, cols) or None
        Cells that show something other than this sensor's skin, undefined outside the disc; None if not reported.
    contact_logit : float32 (rows, cols) or None
    untrusted_logit : float32 (M, M) or None
        Log odds of both; those of untrusted are for fewer, wider cells.
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
    """The outputs of a network for a frame.

    Attributes
    ----------
    depth_and_contact : float32 (2 fold², N, N)
    untrusted : float32 (M, M)
        Log odds that a cell (fewer and wider ones) shows something other than the sensor's skin.
    """

    depth_and_contact: F32
    untrusted: F32


@dataclass(frozen=True, slots=True)
class ShearNetwork:
    """A network for the skin's tangential motion; see `Network`.

    Attributes
    ----------
    fold : int
    cells : int
        Number of cells along a side of its input maps.
    sense : callable
    run : callable
        Returns the shear along x and y, (2, M, M).
    run_touch : callable or None
        Returns the same and float32 (D,) features for a touch model (`core.touch`).
    """

    fold: int
    cells: int
    sense: Callable[[F32], F32]
    run: Callable[[F32, F32], F32]
    run_touch: Callable[[F32, F32], tuple[F32, F32]] | None = None


@dataclass(frozen=True, slots=True)
class Network:
    """A network and the layout of its maps; N = cells / fold.

    Its first layer is linear in its input, so a sensor's reference contributes the same to every frame.

    Attributes
    ----------
    fold : int
        Each square of fold x fold cells becomes fold² channels (`network_maps.fold`).
    sense : callable
        Maps what is known of a sensor, the folded white of the reference and `network_maps.KNOWN` maps, (fold² + KNOWN,
        N, N), to its contribution to the first layer, (channels, N, N).
    run : callable
        Maps the folded white of a frame, (fold², N, N), and the result of `sense` to `NetworkMaps`.
    shear : ShearNetwork
        Runs in addition if shear is requested.
    sigma : SigmaModel or None
        Model of its errors, if they were measured.
    run_touch : callable or None
        Returns the result of `run` and float32 (D,) features for a touch model (`core.touch`).
    """

    fold: int
    sense: Callable[[F32], F32]
    run: Callable[[F32, F32], NetworkMaps]
    shear: ShearNetwork
    sigma: SigmaModel | None = None
    run_touch: Callable[[F32, F32], tuple[NetworkMaps, F32]] | None = None


class Solver(Protocol):
    """Computes depth from the preprocessed images of one sensor."""

    @property
    def grid(self) -> Grid:
        """The grid of its cells, in the camera's pixels."""
        ...

    @property
    def has_shear(self) -> bool:
        """Whether `shear_mm` reports anything."""
        ...

    def solve(self, preprocessed: Preprocessed, mark: Mark, features: Features | None = None) -> Depth:
        """Solve one image in contact; `mark` receives the stages before the last, ``depth``, which the caller marks.

        Appends the features of its network to `features`, if given.
        """
        ...

    def shear_mm(self, preprocessed: Preprocessed, features: Features | None = None) -> F32 | None:
        """Shear of the skin along x and y at the grid's cells, float32 (rows, cols, 2); None if not reported.

        The caller owns the array. It is finite, and undefined outside the disc. `features` is as in `solve`.
        """
        ...


MakeSolver = Callable[[Preprocessor, Network | None], Solver]
"""Prepares a solver for a preprocessor; the network is the profile's, if it names one."""
