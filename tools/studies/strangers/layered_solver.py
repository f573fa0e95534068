"""Solve the layered family's skins, by linear finite elements and relaxation of the contact;
needs numba.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse.linalg import splu

from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.types import F64
from tools.studies.strangers import grid
from tools.studies.strangers.hexahedra import Layer, Mesh, meshed, stiffness
from tools.studies.strangers.layered import LayeredSkin
from tools.studies.strangers.paths import States

POISSON = 0.49
SKIN_PARTS, GEL_PARTS = 2, 4
"""Hexahedra across each layer."""
TOUCHABLE_DEG = 52.0
"""Angle from the tip up to which points may touch an object."""
_TOGETHER = 96


def mesh_of(skin: LayeredSkin, finer: int = 0) -> Mesh:
    """Fill it with hexahedra, with some more of them along every edge of the usual mesh's parts."""
    outer = Layer(skin.skin_mm, SKIN_PARTS + finer // 3, skin.stiffness_ratio, POISSON)
    gel = Layer(skin.gel_part * skin.radius_mm, GEL_PARTS + finer // 3, 1.0, POISSON)
    return meshed(skin.radius_mm, (outer, gel), grid.SQUARE + finer, grid.RINGS + finer)


class LayeredSolver:
    """Solves paths on one skin; making it takes a minute."""

    def __init__(self, skin: LayeredSkin, mesh: Mesh | None = None) -> None:
        mesh = mesh or mesh_of(skin)
        self._skin = skin
        self.rest_mm = mesh.points_mm[: mesh.surface]
        angle = np.arccos(np.clip(self.rest_mm[:, 2] / skin.radius_mm, -1, 1))
        self._touchable = np.flatnonzero(angle < math.radians(TOUCHABLE_DEG))
        self._compliance = compliance(mesh, self._touchable)

    def solved(self, stops: tuple[Press, ...]) -> States:
        """Move an object through its stops."""
        from tools.studies.strangers import contact  # numba is needed only here

        degrees = (3 * self._touchable[:, None] + np.arange(3)).ravel()
        own = self._compliance[degrees]
        forces = contact.solved(
            self.rest_mm[self._touchable], own, self._skin.friction, self._skin.radius_mm, stops
        )
        made = [(self._compliance @ each.ravel()).reshape(-1, 3) for each in forces]
        return States(self.rest_mm, self.rest_mm + np.stack(made))


def compliance(mesh: Mesh, touchable: np.typing.NDArray[np.intp]) -> F64:
    """Motion of the outside, (3 surface, 3 touchable), under unit forces at some of its points."""
    held = (3 * mesh.held[:, None] + np.arange(3)).ravel()
    free = np.setdiff1d(np.arange(3 * len(mesh.points_mm)), held)
    outside = 3 * mesh.surface  # these degrees of freedom come first and none of them is held
    factor = splu(
        stiffness(mesh)[free][:, free].tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    degrees = (3 * touchable[:, None] + np.arange(3)).ravel()
    made = np.empty((outside, len(degrees)))
    for start in range(0, len(degrees), _TOGETHER):
        some = degrees[start : start + _TOGETHER]
        unit = np.zeros((len(free), len(some)))
        unit[some, np.arange(len(some))] = 1.0
        made[:, start : start + _TOGETHER] = factor.solve(unit)[:outside]
    return made
