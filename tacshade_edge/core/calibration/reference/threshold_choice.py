"""Choose the threshold that separates a sensor's markers from the gaps between them."""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.core.calibration.reference.marker_field import MarkerField, find_markers
from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.core.image.white import binarise
from tacshade_edge.types import U8, Binarisation, Disc

# A piece of white below this part of a squared pitch is a speck. Between pins that stand far apart, the local mean is
# near the dark level, and noise makes specks: more than a fifth as many as markers.
_SPECK = 0.03
_SPECKS_PER_MARKER = 0.2
# Otsu's level suits such a sensor if it shows at least this part of the markers as separate pieces.
_SHOWN_PART = 0.85


def choose_binarisation(grey: U8, disc: Disc, pitch_px: float) -> Binarisation:
    """Choose the local mean, or Otsu's level if the local mean makes specks of noise and Otsu's shows the markers.
    `grey` (uint8 (H, W)): image of the unloaded skin. `pitch_px`: marker pitch.
    """
    field = find_markers(grey)
    if field is None:
        return "adaptive"
    mask = disc_mask(grey.shape[0], grey.shape[1], disc).astype(np.uint8)
    speck_px = _SPECK * pitch_px**2
    specks = np.count_nonzero(_piece_sizes(binarise(grey, mask, "adaptive", pitch_px))[1] < speck_px)
    if specks <= _SPECKS_PER_MARKER * len(field.markers_px):
        return "adaptive"
    return "otsu" if _shown_part(field, binarise(grey, mask, "otsu", pitch_px)) >= _SHOWN_PART else "adaptive"


def _piece_sizes(white: U8) -> tuple[np.ndarray, np.ndarray]:
    """The label of each pixel's piece of white, from 1 (0 for black), and the area of each piece, px."""
    _, label, stats, _ = cv2.connectedComponentsWithStats(white)
    return label, stats[1:, cv2.CC_STAT_AREA]


def _shown_part(field: MarkerField, white: U8) -> float:
    """Part of the markers that lie on a piece of white with no other marker."""
    label, sizes = _piece_sizes(white)
    rows, cols = np.rint(field.markers_px).astype(int).T
    inside = (rows >= 0) & (rows < white.shape[0]) & (cols >= 0) & (cols < white.shape[1])
    held = np.bincount(label[rows[inside], cols[inside]], minlength=len(sizes) + 1)
    return float(np.count_nonzero(held[1:] == 1) / len(field.markers_px))
