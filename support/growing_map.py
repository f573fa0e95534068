"""Revisions of a map as a stitching session makes them,
from presses on the simulated pad without reconstruction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tacshade_edge.lab.simulator.pad import touchpad
from tacshade_edge.stitching.session import MapPublisher, MapRevision
from tacshade_edge.stitching.stitcher import SurfaceMap

PAD = touchpad()
RADIUS_MM = 6.0


class GrowingMap:
    """A session whose presses each touch a disc of the pad exactly;
    the pad's corner lies at x, y in the base frame.
    """

    def __init__(
        self, publish: Callable[[str, bytes], None], name: str, x_mm: float = 0.0, y_mm: float = 0.0
    ) -> None:
        self._publish, self._name, self._corner_mm = publish, name, (x_mm, y_mm)
        self._map = SurfaceMap()
        self.presses = self.revision = 0

    def press(self, *places_mm: tuple[float, float]) -> None:
        """Press at places of the pad, then publish the map once."""
        for x_mm, y_mm in places_mm:
            near = np.arange(-RADIUS_MM, RADIUS_MM, 0.125)
            x, y = (grid.ravel() for grid in np.meshgrid(near, near))
            inside = np.hypot(x, y) < RADIUS_MM
            x, y = x[inside] + x_mm, y[inside] + y_mm
            points = np.stack(
                (x + self._corner_mm[0], y + self._corner_mm[1], PAD.height_mm(x, y)), axis=1
            )
            self._map.add(points, np.ones(len(points)))
        self.presses += len(places_mm)
        self._tell(self.presses, "")

    def end(self, folder: str, rejected: int = 0) -> None:
        """Publish the final map."""
        self._tell(self.presses - rejected, folder)

    def _tell(self, used: int, folder: str) -> None:
        self.revision += 1
        about = (self._name, self.revision, self.presses, used, 0x1234ABCD, folder)
        MapPublisher(self._publish).publish(
            MapRevision(*about, self._map.raster)
        )  # a new one: no second between two


def scan(every_mm: float = 8.0) -> Sequence[tuple[float, float]]:
    """Places all over the pad, line after line."""
    inside = (
        np.arange(RADIUS_MM, PAD.length_mm, every_mm),
        np.arange(RADIUS_MM, PAD.width_mm, every_mm),
    )
    return [(float(x), float(y)) for y in inside[0] for x in inside[1]]
