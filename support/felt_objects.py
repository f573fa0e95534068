"""What a tactile sensor's taxels feel of the simulator's objects, and the simulator's own skin."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.lab.mjcf.export import SENSOR_FILE, Parameters, files
from tacshade_edge.lab.mjcf.taxels import Taxels
from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import Skin, height_of
from tacshade_edge.lab.simulator.truth import CONTACT_TOLERANCE_MM, skin_points, skin_under
from tacshade_edge.types import F64, IDENTITY_POSE, Bool


@dataclass(frozen=True, slots=True, eq=False)
class TrueMap:
    """The simulator's skin at the cells in the disc: points (N, 3) and heights (N,) in mm, and
    which touch.
    """

    skin: Skin
    points_mm: F64
    height_mm: F64
    touches: Bool


def depths_mm(taxels: Taxels, press: Press, radius_mm: float) -> F64:
    """The depths (shells, N) of taxels in an object, as MuJoCo states them."""
    distance = press.distance_mm(radius_mm, taxels.points_mm.reshape(-1, 3))
    return np.maximum(-distance, 0).reshape(taxels.points_mm.shape[:2])


def true_map(model: SensorModel, taxels: Taxels, press: Press) -> TrueMap:
    """Press on the simulator, and look at the cells of a sensor in MuJoCo."""
    grid = taxels.grid
    row, col = (each.astype(np.float64) for each in np.nonzero(taxels.inside))
    skin = skin_under(model, (press,))
    points = skin_points(
        skin, model.geometry, grid.row0 + grid.step_px * row, grid.col0 + grid.step_px * col
    )
    height = np.maximum(height_of(points, skin.radius_mm), 0)
    distance = np.abs(press.distance_mm(skin.radius_mm, points))
    return TrueMap(skin, points, height, (height > 0) & (distance <= CONTACT_TOLERANCE_MM))


def written(folder: Path, model: SensorModel, *flange_T_sensor: float) -> Path:
    """Write a sensor's files for MuJoCo; returns that of the sensor."""
    x, y, z, qw, qx, qy, qz = flange_T_sensor or IDENTITY_POSE
    for name, content in files(Parameters(model, (x, y, z, qw, qx, qy, qz))).items():
        (folder / name).write_bytes(content)
    return folder / SENSOR_FILE


def weightless(model: SensorModel) -> Any:
    """An MjSpec of a sensor alone, without gravity."""
    import mujoco

    made = files(Parameters(model, IDENTITY_POSE))
    spec = mujoco.MjSpec.from_string(made[SENSOR_FILE].decode(), assets=made)
    spec.option.gravity = (0, 0, 0)
    return spec
