"""A solver as its author would write it: one file, and one line in `core.depth.SOLVERS`."""

from __future__ import annotations

import numpy as np

from tacshade_edge.core.depth import Depth, Network
from tacshade_edge.core.depth.base import Features, Mark
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.disc_map import rays_in_image
from tacshade_edge.core.image.integral_image import CellMeans
from tacshade_edge.core.image.preprocess import Preprocessed, Preprocessor

CELLS, DEPTH_MM = 28, 1.5


class ToySolver:
    """`DEPTH_MM` deep wherever a cell of its own coarse grid has become whiter."""

    has_shear = False

    def __init__(self, preprocessor: Preprocessor, network: Network | None = None) -> None:
        self.grid = disc_map.map_grid(preprocessor.camera.geometry.disc, CELLS)
        self._inside = rays_in_image(self.grid, preprocessor.camera).inside
        worked_on = disc_map.map_grid(preprocessor.calibration.geometry.disc, CELLS)
        self._cells = CellMeans(preprocessor.integrator, worked_on)
        self._reference = self._cells.means(preprocessor.reference_white) / np.float32(255)

    def solve(self, preprocessed: Preprocessed, mark: Mark, features: Features | None = None) -> Depth:
        """See `core.depth.Solver`."""
        whiter = self._inside & (self._cells.means(preprocessed.white) > self._reference + np.float32(0.1))
        return Depth(np.where(whiter, np.float32(DEPTH_MM), np.float32(0)), whiter)

    def shear_mm(self, preprocessed: Preprocessed, features: Features | None = None) -> None:
        """Tell none."""
