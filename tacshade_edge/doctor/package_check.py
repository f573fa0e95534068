"""Checks the packages that the program runs with."""

from __future__ import annotations

from tacshade_edge.doctor import Findings, fault, ok
from tacshade_edge.requirements import PACKAGES_FIX, missing_requirements


def check_packages() -> Findings:
    """Each package of another version than the program requires; one line if none is."""
    problems = missing_requirements()
    found = tuple(fault("packages", problem, PACKAGES_FIX) for problem in problems)
    return found or (ok("packages", "all have the versions that the program requires"),)
