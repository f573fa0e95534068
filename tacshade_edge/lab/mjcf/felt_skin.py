"""The skin under what a tactile sensor feels: heights, contact and shear at the cells of its map.
Pure.

Depth and drag are those of the simulator (`lab.simulator.skin`, `lab.simulator.drag`): the taxels
give the obstacle, and the poses of the touching bodies how far each has moved since it touched.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from tacshade_edge.lab.mjcf.near_membrane import NearMembrane
from tacshade_edge.lab.mjcf.reach import reached_mm
from tacshade_edge.lab.mjcf.skin_view import (
    STEPS_PER_SIZE,
    at_nodes,
    full,
    over_skin,
    seen,
    touching,
    view_of,
)
from tacshade_edge.lab.mjcf.taxels import Taxels, taxels_of
from tacshade_edge.lab.simulator.drag import DragMechanics, drag_skin, leant_mm
from tacshade_edge.lab.simulator.press import Press, Shape
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.simulated_hand import Grip, moved_along, slid_on
from tacshade_edge.lab.simulator.skin import Skin
from tacshade_edge.lab.simulator.truth import shear_mm
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F32, F64, Bool, frozen

_STILL_MM, _STILL_DEG = 0.02, 0.1
"""Less motion than this drags nothing: it would cost as much as a long drag."""
_Drag = tuple[float, float, float]
_HELD: Final[_Drag] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class TouchingBody:
    """A body that touches the sensor: its number, its pose,
    and a point (3,) of its contact in the sensor frame, mm.
    """

    number: int
    sensor_T_body: Rigid
    at_mm: F64


@frozen
class FeltSkin:
    """The skin at the cells: heights (rows, cols), NaN outside the disc; contact (rows, cols);
    shear (rows, cols, 2), None if it was not asked for.
    """

    height_mm: F32
    contact: Bool
    shear_mm: F32 | None


class SkinMechanics:
    """A sensor's skin, which remembers where each body touched it."""

    def __init__(self, model: SensorModel) -> None:
        # A bulge needs the volume of whole objects, of which the taxels know only the surface.
        self.model = replace(model, bulge=0.0)
        self.taxels: Taxels = taxels_of(model.geometry)
        self._view = view_of(model.geometry, self.taxels, model.form_mm)
        self._membrane = NearMembrane(self._view.flat, self.model.skin_decay_mm)
        self._mechanics = DragMechanics(leant_mm, self._membrane.carry, self._membrane.assume)
        self._seen: F32 = np.zeros(len(self._view.rays.u), np.float32)
        self._grips: dict[int, Grip] = {}

    def forget(self) -> None:
        """Forget what touches, as after a reset of the simulation."""
        self._grips.clear()
        self._begin_flat()

    def _begin_flat(self) -> None:
        self._membrane.forget()
        self._seen = np.zeros_like(self._seen)

    def feel(
        self, depth_mm: F64, bodies: Sequence[TouchingBody], *, with_shear: bool
    ) -> FeltSkin | None:
        """Shape the skin from the depths of its taxels (shells, N), in mm, and the bodies that
        touch; None if nothing presses it in.
        """
        reached, most = reached_mm(self.taxels, depth_mm)
        obstacle = at_nodes(self._view, reached)
        self._grips = {
            body.number: self._grips.get(body.number, Grip(body.sensor_T_body)) for body in bodies
        }
        if not obstacle.any():
            self._begin_flat()
            return None
        skin = self._skin(obstacle, bodies if with_shear else ())
        self._seen, points = seen(self._view, skin, reached, self._seen)
        contact = touching(skin, at_nodes(self._view, most), points)
        inside, shear = self.taxels.inside, None
        if with_shear:
            found = shear_mm(skin, points, self.model.friction).astype(np.float32)
            shear = full(inside, found, math.nan)
        on_grid = np.zeros(inside.shape, np.bool_)
        on_grid[inside] = contact
        return FeltSkin(full(inside, self._seen, math.nan), on_grid, shear)

    def _skin(self, obstacle: F32, bodies: Sequence[TouchingBody]) -> Skin:
        def shape(leaning_mm: F32 | None) -> Skin:
            reach = obstacle
            if leaning_mm is not None:
                reach = np.where(obstacle > 0, np.maximum(obstacle - leaning_mm, 0), 0)
            return self._membrane.over(reach).leaning(leaning_mm)

        drags = [self._drag(body) for body in bodies]
        if not any(any(drag) for drag in drags):
            return shape(None)
        presses = [self._press(body, drag) for body, drag in zip(bodies, drags, strict=True)]
        skin = drag_skin(shape, self.model, presses, self._mechanics, steps_per_size=STEPS_PER_SIZE)
        for body, drag, surplus in zip(bodies, drags, skin.surplus, strict=True):
            self._grips[body.number] = slid_on(self._grips[body.number], drag, surplus)
        return skin

    def _drag(self, body: TouchingBody) -> _Drag:
        x, y, twist = moved_along(self._grips[body.number], body.sensor_T_body, body.at_mm)
        if math.hypot(x, y) < _STILL_MM and abs(twist) < _STILL_DEG:
            return _HELD
        return x, y, twist

    def _press(self, body: TouchingBody, drag: _Drag) -> Press:
        """The body as a press at its contact. Its shape only decides which of several bodies a
        place belongs to: the nearest.
        """
        x, y = over_skin(body.at_mm[:2], self.model.form_mm[0])
        shape = Shape("body", lambda p: np.asarray(np.linalg.norm(p[:, :2], axis=1)))
        along_x, along_y, twist = drag
        return Press(shape, x, y, 0.0, drag_x_mm=along_x, drag_y_mm=along_y, twist_deg=twist)
