"""A state of a session's map that subscribers get."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tacshade_edge.core.stitching.surface_map import Raster


@dataclass(frozen=True, slots=True)
class MapRevision:
    """The map after a press, or the final one.

    Attributes
    ----------
    name : str
        The session's.
    revision : int
        Counts the presses and the end.
    presses, used : int
        Those of the session, and those in the map.
    calibration_crc32 : int
        That the session began with.
    folder : str
        Where the final map's files are; empty before the end.
    raster : callable
        Makes the map in the session's thread; its cost grows with the map, so call it no more often than needed.
    """

    name: str
    revision: int
    presses: int
    used: int
    calibration_crc32: int
    folder: str
    raster: Callable[[], Raster]
