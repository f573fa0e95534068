"""Which threshold separates a sensor's markers from what is between them."""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.core.calibration.reference.marker_field import MarkerField, find_markers
from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.core.image.binarise import binarise
from tacshade_edge.types import U8, Binarisation, Disc

# A piece of white of less than this part of a squared pitch is a speck. Pins that stand far apart leave the mean of
# their neighbourhood near the dark between them, and noise makes specks there: more than half as many as markers.
_SPECK = 0.03
_SPECKS_PER_MARKER = 0.5
# Otsu's level serves such a sensor where it shows at least this part of the markers, each as a piece of its own.
_SHOWN_PART = 0.85


def choose_binarisation(grey: U8, disc: Disc, pitch_px: float) -> Binarisation:
    """Against the mean around, or Otsu's level where that makes specks of noise and this shows each marker.

    Parameters
    ----------
    grey : uint8 (H, W)
        Of the unloaded skin.
    disc : Disc
    pitch_px : float
        Marker pitch.
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
    """The number of each pixel's piece, from 1; and the pieces' areas, px."""
    _, label, stats, _ = cv2.connectedComponentsWithStats(white)
    return label, stats[1:, cv2.CC_STAT_AREA]


def _shown_part(field: MarkerField, white: U8) -> float:
    """Part of the markers that lie on a piece of white with no other marker."""
    label, sizes = _piece_sizes(white)
    rows, cols = np.rint(field.markers_px).astype(int).T
    inside = (rows >= 0) & (rows < white.shape[0]) & (cols >= 0) & (cols < white.shape[1])
    held = np.bincount(label[rows[inside], cols[inside]], minlength=len(sizes) + 1)
    return float(np.count_nonzero(held[1:] == 1) / len(field.markers_px))
