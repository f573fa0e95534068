"""Compute depth from a preprocessed image: a new solver is one file here and one line in `SOLVERS`.

A solver's `solve` appends the features of its network to `features`, if given; `mark` receives the
stages before the last, ``depth``, which the caller marks. `shear_mm` is (rows, cols, 2), finite,
undefined outside the disc.
"""

from collections.abc import Callable
from functools import partial

from tacshade_edge.sensor.depth.hybrid_sfs import HybridSfs, unit_by_grey, with_own_ratio
from tacshade_edge.sensor.depth.learned import LearnedSolver
from tacshade_edge.sensor.depth.sigma import SigmaModel
from tacshade_edge.sensor.depth.solver import Depth, Network
from tacshade_edge.sensor.image.preprocess import Preprocessor

SOLVERS: dict[str, Callable[[Preprocessor, Network | None], HybridSfs | LearnedSolver]] = {
    "hybrid_sfs": HybridSfs,
    "shape_grey": partial(HybridSfs, make_unit=lambda shape: unit_by_grey),
    "learned": LearnedSolver,
}

__all__ = ["SOLVERS", "Depth", "Network", "SigmaModel", "with_own_ratio"]
