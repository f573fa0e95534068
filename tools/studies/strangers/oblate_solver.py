"""Solve the oblate family's skins."""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.lab.simulator.press import Press
from tools.studies.strangers import grid
from tools.studies.strangers.oblate import OblateSkin
from tools.studies.strangers.paths import States
from tools.studies.strangers.shell import Shell, ShellMaterial

SQUARE, RINGS, RIM_DEG = 7, 8, 60.0
"""The mesh (`grid.directions`)."""


class OblateSolver:
    """Solves paths on one skin."""

    def __init__(self, skin: OblateSkin, square: int = SQUARE, rings: int = RINGS) -> None:
        direction, quads = grid.directions(square, rings, RIM_DEG)
        rest_mm = direction * skin.rest_mm(direction)[:, None]
        clamped = np.flatnonzero(direction[:, 2] < math.cos(math.radians(RIM_DEG - 0.1)))
        material = ShellMaterial(skin.thickness_mm, skin.gel_per_mm, skin.gel_along, skin.friction)
        triangles = np.concatenate((quads[:, (0, 1, 2)], quads[:, (0, 2, 3)]))
        self._radius_mm = skin.radius_mm
        self._shell = Shell(rest_mm, triangles, clamped, material)

    def solved(self, stops: tuple[Press, ...]) -> States:
        """Move an object through its stops."""
        return States(self._shell.rest_mm, np.stack(self._shell.solved(self._radius_mm, stops)))
