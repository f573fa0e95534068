"""Compute depth from a preprocessed image: a new solver is one file here and one line in `SOLVERS`."""

from tacshade_edge.core.depth.base import Depth, MakeSolver, Network, Solver
from tacshade_edge.core.depth.hybrid_sfs import HybridSfs
from tacshade_edge.core.depth.learned import LearnedSolver
from tacshade_edge.core.depth.sigma import SigmaModel

SOLVERS: dict[str, MakeSolver] = {
    "hybrid_sfs": HybridSfs,
    "learned": LearnedSolver,
}

__all__ = ["SOLVERS", "Depth", "MakeSolver", "Network", "SigmaModel", "Solver"]
