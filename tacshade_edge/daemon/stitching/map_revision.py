"""A state of a session's map, for subscribers."""

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
        Name of the session.
    revision : int
        Counts the presses and the end.
    presses, used : int
        Number of presses in the session, and in the map.
    calibration_crc32 : int
        CRC-32 of the calibration that the session began with.
    folder : str
        Folder of the final map's files; empty before the end.
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
