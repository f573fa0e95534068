"""Depth from grey maps: a new solver is one file and one line here. The learned one takes the white pixels instead."""

from tacshade_edge.core.depth import hybrid_sfs
from tacshade_edge.core.depth.base import Depth, GreyMaps, Solver

SOLVERS: dict[str, Solver] = {"paper": hybrid_sfs.solve, "grey": hybrid_sfs.scaled_grey}

__all__ = ["SOLVERS", "Depth", "GreyMaps", "Solver"]
