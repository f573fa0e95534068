"""Depth from grey maps: a new solver is one file and one line here. The learned one takes the white pixels instead."""

from tacshade_edge.core.solvers import paper
from tacshade_edge.core.solvers.base import Depth, GreyMaps, Solver

SOLVERS: dict[str, Solver] = {"paper": paper.solve, "grey": paper.scaled_grey}

__all__ = ["SOLVERS", "Depth", "GreyMaps", "Solver"]
