"""Does a reference show a press? Seen by the camera, the markers of a free skin stand closest in
its middle, and their spacing grows smoothly towards the rim; where something presses, they stand
further apart.
"""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode, finding
from tacshade_edge.calibration.reference.marker_field import MarkerField, find_markers
from tacshade_edge.types import F64, U8, Geometry, frozen

# A marker's spacing is the median distance to this many neighbours, which one that was not found
# hardly changes.
_NEIGHBOURS = 3
# A usual distance of the camera in skin radii, if none is stated, and the part of the growth
# through a fisheye lens that a free skin shows at least.
_USUAL_DISTANCE, _LEAST_GROWTH = 0.7, 0.75
# Places and sizes of a press that are tried, in radii of the visible circle.
_PLACES, _REACH, _SIZES = np.linspace(-0.6, 0.6, 7), 0.75, (0.3, 0.45, 0.6)
# Fits with weights (Cauchy's) that ignore single markers: their number, deviations that still
# count, the least deviation of a log spacing, which counts for every marker, and the most.
_FITS, _DEVIATIONS, _LEAST_DEVIATION, _MOST_LOSS = 4, 2.0, 0.003, 0.15
PRESSED, _SURE_LOG_FACTOR = 0.035, 0.3
"""A `strength` that no free skin has: 0.029 at most, of a jittered spiral through a fisheye lens.
tools/studies/loads.py measures what this finds."""


@frozen
class Widening:
    """Where markers stand further apart than on a free skin: the place (row, col), px, by which
    factor, and the part of all deviations from a smooth spacing that this explains, 0 to 1.
    """

    row_px: float
    col_px: float
    factor: float
    part: float

    @property
    def strength(self) -> float:
        """How surely this is a press: the log of the factor, up to that of a sure one,
        times the part.
        """
        return self.part * min(math.log(self.factor), _SURE_LOG_FACTOR)


def widening_finding(grey: U8, geometry: Geometry) -> CalibrationFinding | None:
    """That markers show a load in a reference; None if they do not."""
    field = find_markers(grey)
    found = widening_of(field, geometry) if field else None
    if found is None or found.strength < PRESSED:
        return None
    return finding(
        FindingCode.PRESSED_MARKERS,
        row_px=found.row_px,
        col_px=found.col_px,
        percent=100 * (found.factor - 1),
    )


def widening_of(field: MarkerField, geometry: Geometry) -> Widening | None:
    """Find the most likely press; None if too few markers lie in the visible circle."""
    disc = geometry.disc
    unit = (field.markers_px - (disc.row_c, disc.col_c)) / disc.radius_px
    rho = np.hypot(unit[:, 0], unit[:, 1])
    inside = rho <= 1
    if np.count_nonzero(inside) < 2 * _NEIGHBOURS:
        return None
    unit, rho = unit[inside], rho[inside]
    beyond = log_spacing(field)[inside] - _LEAST_GROWTH * log_growth(geometry, rho)
    # Both signs of the mean and of a tilt, because all parts count at least zero times.
    free = np.stack([np.ones_like(rho), unit[:, 0], unit[:, 1]], axis=1)
    smooth = np.hstack([free, -free, rho[:, None] ** 2, rho[:, None] ** 4])
    # The free skin is fitted too, so what a press explains is counted beyond any smooth growth.
    loss, _ = _fitted(smooth, beyond)
    best = Widening(disc.row_c, disc.col_c, 1.0, 0.0)
    for size in _SIZES:
        for row in _PLACES:
            for col in _PLACES[np.hypot(row, _PLACES) <= _REACH]:
                press = np.exp(-((unit[:, 0] - row) ** 2 + (unit[:, 1] - col) ** 2) / size**2)
                left, widened = _fitted(np.column_stack([smooth, press]), beyond)
                part = 1 - left / loss
                if part > best.part:
                    best = Widening(
                        disc.row_c + row * disc.radius_px,
                        disc.col_c + col * disc.radius_px,
                        math.exp(widened),
                        part,
                    )
    return best


def log_spacing(field: MarkerField) -> F64:
    """The log of each marker's spacing in px, (N,)."""
    from scipy.spatial import cKDTree  # a daemon that takes no reference does not need it

    distance, _ = cKDTree(field.markers_px).query(field.markers_px, k=_NEIGHBOURS + 1)
    spacing: F64 = np.log(np.median(distance[:, 1:], axis=1))
    return spacing


def log_growth(geometry: Geometry, rho: F64) -> F64:
    """By how much the log spacing of an even lattice grows from the middle to `rho`, radii of the
    visible circle, in the view of an equidistant fisheye lens, through which it grows least: a
    point of a dome at polar angle θ, the camera c behind its centre, is seen at an angle ψ, and
    areas grow as dψ/dθ ψ / sinθ.
    """
    if geometry.skin == "pad":
        return np.zeros_like(rho)
    r = geometry.skin_radius_mm
    c = geometry.camera_distance_mm or _USUAL_DISTANCE * r
    theta = np.linspace(1e-3, math.radians(geometry.visible_half_angle_deg), 200)
    across, ahead = r * np.sin(theta), r * np.cos(theta) + c
    psi = np.arctan2(across, ahead)
    slope = r * (r + c * np.cos(theta)) / (across**2 + ahead**2)
    growth = 0.5 * np.log(slope * psi / np.sin(theta))
    at_rho: F64 = np.interp(rho, psi / psi[-1], growth - growth[0])
    return at_rho


def _fitted(parts: F64, values: F64) -> tuple[float, float]:
    """Fit a sum of parts, each at least zero times, to values; return the loss and the last part's
    times.
    """
    from scipy.optimize import nnls

    weight = np.ones(len(values))
    for _ in range(_FITS):
        root = np.sqrt(weight)
        times, _ = nnls(parts * root[:, None], values * root)
        off = np.abs(values - parts @ times)
        deviation = 1.4826 * float(np.median(off)) + _LEAST_DEVIATION
        weight = 1 / np.maximum(1, (off / (_DEVIATIONS * deviation)) ** 2)
    return float(np.minimum(off + _LEAST_DEVIATION, _MOST_LOSS).sum()), float(times[-1])
