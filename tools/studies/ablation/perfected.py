"""A network in which the truth replaces some of the outputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tacshade_edge.core.depth import Network, NetworkMaps
from tacshade_edge.core.depth.network_maps import HEIGHT_SCALE, fold, unfold
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.simulator.press import distance_mm
from tacshade_edge.simulator.scene import SimulatedFrame
from tacshade_edge.simulator.truth import CONTACT_TOLERANCE_MM, skin_points
from tacshade_edge.types import F32, Bool, Geometry

SURE = 10.0
"""Log odds of a known contact."""


class PerfectedNetwork:
    """Runs a network and replaces its heights, its contact, both, or its greatest height with the truth.

    The truth is the one last given to `show`.
    """

    def __init__(self, network: Network, *, height: bool = False, contact: bool = False, top: bool = False) -> None:
        self._network = network
        self._perfect = (height, contact, top)
        self._height: F32 = np.zeros((0, 0), np.float32)
        self._contact: Bool = np.zeros((0, 0), bool)

    def show(self, height: F32, contact: Bool) -> None:
        """Set the truth of the next frame, which the network should output (`true_answer`)."""
        self._height, self._contact = height, contact

    def as_network(self) -> Network:
        """Return a network for a reconstructor."""
        return replace(self._network, run=self._run)

    def _run(self, white: F32, sensor: F32) -> NetworkMaps:
        height, contact, top = self._perfect
        maps = self._network.run(white, sensor)
        found, logit = unfold(maps.depth_and_contact, self._network.fold)
        if contact:
            logit = np.where(self._contact, np.float32(SURE), np.float32(-SURE))
        if height:
            found = self._height
        elif top and (touched := logit > 0).any() and found[touched].max() > 0:
            found = found * (self._height.max() / found[touched].max())
        perfected = fold(np.stack((found, logit)).astype(np.float32), self._network.fold)
        return replace(maps, depth_and_contact=perfected)


def true_answer(frame: SimulatedFrame, seen: Geometry, cells: int) -> tuple[F32, Bool]:
    """Compute what the network should output for a frame, at the cells of a calibration's disc map.

    Returns
    -------
    height : float32 (cells, cells)
        h in tenths of the disc's radius, 0 outside the disc.
    contact : bool (cells, cells)
    """
    grid = disc_map.map_grid(seen.disc, cells)
    axis = grid.step_px * np.arange(cells)
    rows = np.repeat(grid.row0 + axis, cells)
    cols = np.tile(grid.col0 + axis, cells)
    geometry = frame.model.geometry
    inside = np.hypot(rows - geometry.disc.row_c, cols - geometry.disc.col_c) <= geometry.disc.radius_px
    height, contact = np.zeros(len(rows), np.float32), np.zeros(len(rows), bool)
    points = skin_points(frame.skin, geometry, rows[inside], cols[inside])
    h = np.maximum(frame.skin.radius_mm - np.linalg.norm(points, axis=1), 0)
    off = np.abs(distance_mm(frame.presses, frame.skin.radius_mm, points))
    height[inside], contact[inside] = h, (h > 0) & (off <= CONTACT_TOLERANCE_MM)
    unit_mm = seen.skin_radius_mm * np.sin(np.radians(seen.visible_half_angle_deg))
    shape = (cells, cells)
    return (height * (HEIGHT_SCALE / unit_mm)).astype(np.float32).reshape(shape), contact.reshape(shape)
