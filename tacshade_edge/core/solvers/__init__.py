"""Depth solvers behind one protocol; a new one is one file and one line here. The learned one stands beside them."""

from tacshade_edge.core.solvers import fast, paper
from tacshade_edge.core.solvers.base import Depth, DepthScale, GreyMaps, Solver

LEARNED = "accurate"
"""The solver that works on the binarised frame and finds the contact too (`accurate`): it is no entry of `SOLVERS`."""

SOLVERS: dict[str, Solver] = {"paper": paper.solve, "fast": fast.solve}

__all__ = ["LEARNED", "SOLVERS", "Depth", "DepthScale", "GreyMaps", "Solver"]
