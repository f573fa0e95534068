"""Depth solvers behind one protocol; a new one is one file and one line here."""

from tacshade_edge.core.solvers import fast, paper
from tacshade_edge.core.solvers.base import Depth, DepthScale, GreyMaps, Solver

SOLVERS: dict[str, Solver] = {"paper": paper.solve, "fast": fast.solve}

__all__ = ["SOLVERS", "Depth", "DepthScale", "GreyMaps", "Solver"]
