"""Find the markers of a reference one by one, however bright the rings and lamps around them."""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.sensor.image.white import binarise
from tacshade_edge.types import F32, F64, U8, Binarisation, Disc, frozen

# The search for blobs shrinks the shorter side to this, and takes extrema of both signs of the
# difference of two Gaussians (D. Marr and E. Hildreth, 1980) at these sizes.
_SEARCH_PX = 240
_SIGMAS_PX = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
_WIDER = 1.6
_LEAST_CONTRAST_GREY = 2.0
# Neighbours in a pattern have about the same pitch and contrast; lamps, screws and reflections do
# not. A marker has at least this many neighbours, a pattern this many markers; fewer than `_MANY`
# must be more even, and at least this part of all blobs of half their contrast, or they are the
# middle of a pressed skin.
_NEAREST = 9
_PITCHES, _UNLIKE_PITCH, _UNLIKE_CONTRAST = 1.4, 1.4, 1.6
_LEAST_NEIGHBOURS, LEAST_MARKERS, _MANY, _FEW_PART = 3, 19, 60, 0.8
# Standard deviation of the log ratio of neighbours' pitches: 0.04 to 0.1 in patterns, 0.13 or more
# in noise (0.06 at most and 0.1 among few); and the rate at which a field's score falls with it.
_MOST_UNEVEN, _MOST_UNEVEN_FEW, _EVENNESS = 0.115, 0.08, 14.0
# Least part of a field's hull filled by its markers' cells:
# patterns fill 0.8 or more, strings in noise less.
_LEAST_FILLED = 0.7
# A visible circle holds at least this part of the markers: the corners of a hexagon of 127 are 0.05
# of them. A marker that the rim cuts may seem to lie outside by up to this many pitches (0.12 in
# the simulator).
_HELD_PART, _CUT_PITCHES, _SAMPLES = 0.985, 0.25, 41
_HALF_PX = 0.5
# A smaller image has no room for a marker and its neighbours.
_LEAST_PX = 16
_HEXAGON = 3**0.5 / 2
"""Area of a lattice cell, in squared pitches."""


@frozen
class MarkerField:
    """The markers, or pins, of one image: (row, col) (N, 2), N at least `LEAST_MARKERS`; the median
    distance to the three nearest; the smallest circle around all, plus half a pitch.
    """

    markers_px: F64
    pitch_px: float
    circle: Disc

    @property
    def hull_px(self) -> F64:
        """Row and column of the outermost markers, (N, 2)."""
        return np.asarray(cv2.convexHull(self.markers_px.astype(np.float32))[:, 0], np.float64)

    def holds(self, disc: Disc, part: float = _HELD_PART) -> bool:
        """Whether nearly all markers, or this part of them, lie in a circle."""
        far = np.linalg.norm(self.markers_px - (disc.row_c, disc.col_c), axis=1)
        return bool(np.mean(far <= disc.radius_px + _CUT_PITCHES * self.pitch_px) >= part)

    def filled_part(self, disc: Disc, shape: tuple[int, ...]) -> float:
        """Part of a circle's visible area that lies within a pitch of a marker, 0 to 1."""
        step = np.linspace(-1, 1, _SAMPLES)
        rows, cols = (axis.ravel() for axis in np.meshgrid(step, step, indexing="ij"))
        unit = np.stack((rows, cols), axis=1)[np.hypot(rows, cols) <= 1]
        places = np.array((disc.row_c, disc.col_c)) + disc.radius_px * unit
        # Pixel centres are whole numbers, so an image reaches half a pixel beyond them.
        first, last = -_HALF_PX, np.array(shape[:2]) - _HALF_PX
        places = places[((places >= first) & (places <= last)).all(axis=1)]
        if not len(places):
            return 0.0
        from scipy.spatial import cKDTree  # a daemon that takes no reference does not need it

        nearest, _ = cKDTree(self.markers_px).query(places)
        return float(np.mean(nearest <= self.pitch_px))


def find_markers(grey: U8) -> MarkerField | None:
    """Find the largest and most even field of blobs of one size in a grey image;
    None if there is none.
    """
    scale = min(grey.shape) / _SEARCH_PX
    if min(grey.shape) < _LEAST_PX:
        return None
    method = cv2.INTER_AREA if scale > 1 else cv2.INTER_CUBIC
    small = cv2.resize(grey, None, fx=1 / scale, fy=1 / scale, interpolation=method).astype(
        np.float32
    )
    best, best_score = None, 0.0
    for sigma_px in _SIGMAS_PX:
        difference = cv2.GaussianBlur(small, (0, 0), sigma_px) - cv2.GaussianBlur(
            small, (0, 0), _WIDER * sigma_px
        )
        # White pins on black, and black pins between white markers.
        for signed in (difference, -difference):
            found = _even_field(*_extrema(signed, sigma_px))
            if found is not None and (score := _score(*found)) > best_score:
                best, best_score = found, score
    if best is None:
        return None
    points, pitch, _ = best
    # Pixel centres are whole numbers: resizing keeps the image's corners, not its first pixel.
    markers = (points + 0.5) * scale - 0.5
    (col, row), radius = cv2.minEnclosingCircle(markers[:, ::-1].astype(np.float32))
    return MarkerField(
        markers, pitch * scale, Disc(float(row), float(col), float(radius) + pitch * scale / 2)
    )


def _extrema(difference: F32, sigma_px: float) -> tuple[F64, F32]:
    """Places (row, column) and values of the maxima."""
    side = 2 * int(np.ceil(1.2 * sigma_px)) + 1
    highest = cv2.dilate(difference, np.ones((side, side), np.uint8))
    rows, cols = np.nonzero((difference >= highest) & (difference > _LEAST_CONTRAST_GREY))
    return np.stack((rows, cols), axis=1).astype(np.float64), difference[rows, cols]


def _even_field(points: F64, contrast: F32) -> tuple[F64, float, float] | None:
    """The largest set of blobs spaced like a pattern, its pitch and unevenness;
    None if too few or too uneven.
    """
    if len(points) < LEAST_MARKERS:
        return None
    from scipy.sparse import coo_matrix, csr_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    distance, index = cKDTree(points).query(points, k=_NEAREST)
    pitch = np.median(distance[:, 1:4], axis=1)
    one, other = np.repeat(np.arange(len(points)), _NEAREST - 1), index[:, 1:].ravel()
    nearer, further = np.minimum(pitch[one], pitch[other]), np.maximum(pitch[one], pitch[other])
    fainter, stronger = (
        np.minimum(contrast[one], contrast[other]),
        np.maximum(contrast[one], contrast[other]),
    )
    alike = distance[:, 1:].ravel() < _PITCHES * nearer
    alike &= (further < _UNLIKE_PITCH * nearer) & (stronger < _UNLIKE_CONTRAST * fainter)
    links = coo_matrix(
        (np.ones(np.count_nonzero(alike)), (one[alike], other[alike])), shape=(len(points),) * 2
    )
    graph = csr_matrix((links + links.T) > 0)
    kept = np.flatnonzero(np.asarray(graph.sum(axis=1)).ravel() >= _LEAST_NEIGHBOURS)
    if len(kept) < LEAST_MARKERS:
        return None
    _, label = connected_components(graph[kept][:, kept], directed=False)
    # Lamps form fields too, but smaller ones.
    field = kept[label == np.argmax(np.bincount(label))]
    if len(field) < LEAST_MARKERS:
        return None
    inside = np.isin(one, field) & np.isin(other, field) & alike
    uneven = float(np.std(np.log(pitch[one[inside]] / pitch[other[inside]])))
    if len(field) < _MANY:
        alike_blobs = np.count_nonzero(contrast > 0.5 * np.median(contrast[field]))
        if uneven > _MOST_UNEVEN_FEW or len(field) < _FEW_PART * alike_blobs:
            return None
    return (
        (points[field], float(np.median(pitch[field])), uneven) if uneven <= _MOST_UNEVEN else None
    )


def _score(points: F64, pitch: float, uneven: float) -> float:
    """Score of a field: the area that it covers, less if uneven; 0 for a string of blobs."""
    area = float(cv2.contourArea(cv2.convexHull(points.astype(np.float32))))
    filled = min(len(points) * _HEXAGON * pitch**2 / max(area, 1.0), 1.0)
    return area * filled**2 * float(np.exp(-_EVENNESS * uneven)) if filled >= _LEAST_FILLED else 0.0


# A piece of white below this part of a squared pitch is a speck. Between pins that stand far apart,
# the local mean is near the dark level, and noise makes specks: more than a fifth as many as
# markers.
_SPECK = 0.03
_SPECKS_PER_MARKER = 0.2
# Otsu's level suits such a sensor if it shows at least this part of the markers as separate pieces.
_SHOWN_PART = 0.85


def choose_binarisation(grey: U8, disc: Disc, pitch_px: float) -> Binarisation:
    """Choose the local mean, or Otsu's level if the local mean makes specks of noise
    and Otsu's shows the markers.
    """
    field = find_markers(grey)
    if field is None:
        return "adaptive"
    mask = disc_mask(grey.shape[0], grey.shape[1], disc).astype(np.uint8)
    speck_px = _SPECK * pitch_px**2
    specks = np.count_nonzero(
        _piece_sizes(binarise(grey, mask, "adaptive", pitch_px))[1] < speck_px
    )
    if specks <= _SPECKS_PER_MARKER * len(field.markers_px):
        return "adaptive"
    return (
        "otsu"
        if _shown_part(field, binarise(grey, mask, "otsu", pitch_px)) >= _SHOWN_PART
        else "adaptive"
    )


def _piece_sizes(white: U8) -> tuple[np.ndarray, np.ndarray]:
    """The label of each pixel's piece of white, from 1 (0 for black), and the area of each piece,
    px.
    """
    _, label, stats, _ = cv2.connectedComponentsWithStats(white)
    return label, stats[1:, cv2.CC_STAT_AREA]


def _shown_part(field: MarkerField, white: U8) -> float:
    """Part of the markers that lie on a piece of white with no other marker."""
    label, sizes = _piece_sizes(white)
    rows, cols = np.rint(field.markers_px).astype(int).T
    inside = (rows >= 0) & (rows < white.shape[0]) & (cols >= 0) & (cols < white.shape[1])
    held = np.bincount(label[rows[inside], cols[inside]], minlength=len(sizes) + 1)
    return float(np.count_nonzero(held[1:] == 1) / len(field.markers_px))
