"""What a tactile sensor's taxels feel of the simulator's objects, and the simulator's own skin."""

from __future__ import annotations

import numpy as np

from tacshade_edge.lab.mjcf.taxels import Taxels
from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import height_of
from tacshade_edge.lab.simulator.truth import CONTACT_TOLERANCE_MM, skin_points, skin_under
from tacshade_edge.types import F64, Bool


def depths_mm(taxels: Taxels, press: Press, radius_mm: float) -> F64:
    """The depths (shells, N) of taxels in an object, as MuJoCo states them."""
    distance = press.distance_mm(radius_mm, taxels.points_mm.reshape(-1, 3))
    return np.maximum(-distance, 0).reshape(taxels.points_mm.shape[:2])


def true_map(model: SensorModel, taxels: Taxels, press: Press) -> tuple[F64, Bool]:
    """The simulator's heights (N,) at the cells in the disc, and which of them touch."""
    grid = taxels.grid
    row, col = (each.astype(np.float64) for each in np.nonzero(taxels.inside))
    skin = skin_under(model, (press,))
    points = skin_points(
        skin, model.geometry, grid.row0 + grid.step_px * row, grid.col0 + grid.step_px * col
    )
    height = np.maximum(height_of(points, skin.radius_mm), 0)
    distance = np.abs(press.distance_mm(skin.radius_mm, points))
    return height, (height > 0) & (distance <= CONTACT_TOLERANCE_MM)
