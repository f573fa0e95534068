"""The interface of all solvers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from tacshade_edge.core.depth.sigma import SigmaModel
from tacshade_edge.core.geometry.disc import Grid
from tacshade_edge.core.image.preprocess import Preprocessed, Preprocessor
from tacshade_edge.types import F32, Bool, frozen

Mark = Callable[[str], None]
"""Called with a stage's name at its end, so that a caller with a clock can time it."""


Features = list[F32]
"""Collects the features for a touch model, network by network."""


@frozen
class Depth:
    """A solver's answer on its grid. `height_mm` is finite and not below 0, `contact` (None if only the heights show
    it) is False outside the disc, where else values are undefined; `repaired_px` counts values that were not finite,
    replaced by 0; `untrusted` cells show something other than this sensor's skin. The log odds of untrusted are (M, M),
    for fewer, wider cells.
    """

    height_mm: F32
    contact: Bool | None = None
    saturated: bool = False
    repaired_px: int = 0
    untrusted: Bool | None = None
    contact_logit: F32 | None = None
    untrusted_logit: F32 | None = None


@dataclass(frozen=True, slots=True, eq=False)
class NetworkMaps:
    """The outputs of a network for a frame: (2 fold², N, N) depth and contact, and (M, M) log odds that a cell (fewer
    and wider ones) shows something other than the sensor's skin.
    """

    depth_and_contact: F32
    untrusted: F32


@dataclass(frozen=True, slots=True)
class ShearNetwork:
    """A network for the skin's tangential motion; see `Network`. `run` returns the shear along x and y, (2, M, M),
    `run_touch` that and the features (D,) for a touch model.
    """

    fold: int
    cells: int
    sense: Callable[[F32], F32]
    run: Callable[[F32, F32], F32]
    run_touch: Callable[[F32, F32], tuple[F32, F32]] | None = None


@dataclass(frozen=True, slots=True)
class Network:
    """A network and the layout of its maps; N = cells / fold: each square of fold x fold cells becomes fold² channels.

    Its first layer is linear in its input, so a sensor's reference contributes the same to every frame: `sense` maps
    the folded white of the reference and `learned.KNOWN` maps, (fold² + KNOWN, N, N), to that contribution,
    (channels, N, N). `run` maps the folded white of a frame, (fold², N, N), and that to `NetworkMaps`; `run_touch` also
    returns features (D,) for a touch model (`core.touch`). `shear` runs in addition if requested.
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
        """Solve one image in contact, and append the features of its network to `features`, if given; `mark` receives
        the stages before the last, ``depth``, which the caller marks.
        """
        ...

    def shear_mm(self, preprocessed: Preprocessed, features: Features | None = None) -> F32 | None:
        """Shear of the skin along x and y, (rows, cols, 2), finite, undefined outside the disc, the caller's; None if
        not reported.
        """
        ...


MakeSolver = Callable[[Preprocessor, Network | None], Solver]
"""Prepares a solver for a preprocessor; the network is the profile's, if it names one."""
