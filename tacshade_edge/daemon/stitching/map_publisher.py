"""Publishes a stitching session: ``map/revision`` and ``map/cloud`` as it grows, then ``map/final``."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from tacshade_edge.core.stitching.surface_map import Raster
from tacshade_edge.daemon.stitching.map_revision import MapRevision
from tacshade_edge.protocol.json_payload import encode_json
from tacshade_edge.protocol.wire import encode_map_cloud
from tacshade_edge.types import F32

PERIOD_S = 1.0
POINTS_MAX = 20_000
"""Most points of a ``map/cloud``, 280 kB; a larger map is thinned."""


class MapPublisher:
    """Publishes maps, at most once a second while they grow: the larger the map, the more its raster costs.

    Parameters
    ----------
    publish : callable
        ``publish(topic, payload)``, retained, QoS 1; must not wait.
    """

    def __init__(self, publish: Callable[[str, bytes], None]) -> None:
        self._publish = publish
        self._next_s = 0.0

    def publish(self, revision: MapRevision) -> bool:
        """Publish a revision; return True if it is deferred because one was just published. The final one never is."""
        now_s = time.monotonic()
        if not revision.folder and now_s < self._next_s:
            return True
        self._next_s = now_s + PERIOD_S
        raster = revision.raster()
        points, spacing_mm = thinned_points(raster)
        known = raster.z_mm[np.isfinite(raster.z_mm)]
        about = {
            "name": revision.name,
            "revision": revision.revision,
            "presses": revision.presses,
            "used": revision.used,
            "x0_mm": raster.x0_mm,
            "y0_mm": raster.y0_mm,
            "width_mm": raster.z_mm.shape[1] * raster.step_mm,
            "length_mm": raster.z_mm.shape[0] * raster.step_mm,
            "z_min_mm": float(known.min()) if known.size else None,
            "z_max_mm": float(known.max()) if known.size else None,
            "area_mm2": known.size * raster.step_mm**2,
            "points": len(points),
            "spacing_mm": spacing_mm,
            "folder": revision.folder,
        }
        cloud = encode_map_cloud(
            points,
            revision=revision.revision,
            calibration_crc32=revision.calibration_crc32,
            t_ns=time.monotonic_ns(),
            wall_ns=time.time_ns(),
        )
        self._publish("map/cloud", cloud)
        self._publish("map/final" if revision.folder else "map/revision", encode_json(about))
        return False


def thinned_points(raster: Raster) -> tuple[F32, float]:
    """Points (N, 3) of every k-th row and column, with the least k for `POINTS_MAX`, and their spacing in mm."""
    stride = 1
    while np.count_nonzero(np.isfinite(raster.z_mm[::stride, ::stride])) > POINTS_MAX:
        stride += 1
    spacing_mm = stride * raster.step_mm
    thin = Raster(raster.z_mm[::stride, ::stride], raster.x0_mm, raster.y0_mm, spacing_mm)
    return thin.points().astype(np.float32), spacing_mm
