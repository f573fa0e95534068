"""A print of no known kind, drawn from the sensor's own picture: white tips carry the patches of
the reference around them.

A pixel belongs to the nearest tip. It moves to where the skin moves that tip, and grows as the tip
comes nearer to the camera. Glare stands still, because it comes from the lamp. What pins hide and
uncover is not drawn, so a print of a known kind explains its own sensors better.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from tacshade_edge.lab.fitting.lattice import Layout, Tips, find_tips
from tacshade_edge.lab.fitting.prints import (
    WHITE_TIP_DEVIATIONS,
    Found,
    Kind,
    TwinRenderer,
    base_model,
    print_of,
)
from tacshade_edge.lab.simulator.render import FRUSTUM, project, smoothed
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import Skin, undeformed
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.types import F32, F64, I64, Bool, Calibration

PATCHES = Kind(white_tips=True, marker_parts=(), profile=FRUSTUM, patches=True)
LENGTHS_PITCHES = (0.3, 0.45, 0.65, 0.9, 1.2, 1.6, 2.0)
"""Lengths of pins among which touches choose: a picture at rest shows where tips are,
but not how deep they lie.
"""
USUAL_PITCHES = 0.9
"""The length with which tips are placed before touches show it."""
LENGTH_DEVIATION = 0.15
"""Standard deviation of a length that touches chose, as a part of it:
half a step of `LENGTHS_PITCHES`.
"""
LEAST_TIPS = 20
GLARE = 1.5
"""What is brighter than this many times a bright tip is glare."""
_BRIGHT_PERCENTILE = 75.0
_GLARE_PX = 5
_BLUR_PX = 1.0
_TIP_PITCHES = (0.25, 0.25, 0.4)
"""Radii of tips, bases and markers: only the patch of skin over
which a pin feels the slope depends on them.
"""


def own_picture(calibration: Calibration) -> Found | None:
    """The print that consists of the reference's patches; None if too few tips are seen."""
    # Divided by the light around: on a real TacTip of 127 pins, 92 were found and not 56.
    tips = find_tips(calibration, white_tips=True, length_pitches=USUAL_PITCHES, divided=True)
    if len(tips) < LEAST_TIPS:
        return None
    values = np.array((USUAL_PITCHES, *_TIP_PITCHES, _BLUR_PX))
    grey = calibration.reference_grey
    disc = calibration.geometry.disc
    mask = disc_mask(grey.shape[0], grey.shape[1], disc)
    return Found(
        kind=PATCHES,
        values=values,
        covariance=np.zeros((len(values), len(values))),
        residual=0.0,
        tips=Tips(tips),
        base=base_model(calibration),
        light=np.where(mask, grey, 0).astype(np.float32),
        deviations=WHITE_TIP_DEVIATIONS,
        around=np.where(mask, 0, grey).astype(np.float32),
    )


def with_length(found: Found, length_pitches: float) -> Found:
    """The same print with pins of another length."""
    values, deviations = found.values.copy(), found.deviations.copy()
    values[0], deviations[0] = length_pitches, LENGTH_DEVIATION * length_pitches
    return replace(found, values=values, deviations=deviations)


def renderer_of(found: Found, model: SensorModel, layout: Layout) -> TwinRenderer:
    """Draws the pictures of a print that was found, for a sensor of its cloud."""
    marks = print_of(model, found.kind, layout)
    if found.kind.patches:
        return PatchRenderer(model, found)
    return TwinRenderer(model, found.kind, marks, found.light)


class PatchRenderer(TwinRenderer):
    """Draws skins by moving the patches of a reference."""

    def __init__(self, model: SensorModel, found: Found) -> None:
        assert found.tips is not None
        super().__init__(model, PATCHES, print_of(model, PATCHES, found.tips), found.light)
        self._rest_px, self._rest_mm = self._tips(undeformed(model.skin_radius_mm))
        picture = found.light
        rows, cols, seen = self._pixels(self._rest_px, picture.shape)
        tips = cv2.GaussianBlur(picture, (0, 0), _BLUR_PX)[rows[seen], cols[seen]]
        # Against bright tips, not the mean: how much of a picture is tips differs between sensors.
        glare_grey = GLARE * float(np.percentile(tips, _BRIGHT_PERCENTILE))
        bright = (picture > glare_grey).astype(np.uint8)
        # Light that the dome reflects stays where it is when the skin moves.
        still = cv2.dilate(bright, np.ones((_GLARE_PX, _GLARE_PX), np.uint8)).view(bool)
        self._still = np.where(still, picture, 0) + found.around
        self._moving = np.minimum(picture, np.float32(glare_grey))
        self._shown = ~still & (found.around == 0)
        down, across = np.indices(picture.shape).astype(np.float32)
        self._down, self._across = down, across

    def draw(self, skin: Skin) -> F32:
        """The noiseless image of a skin: float32 (H, W), grey levels."""
        px, far_mm = self._tips(skin)
        rows, cols, seen = self._pixels(px, self._moving.shape)
        seeds = np.ones(self._moving.shape, np.uint8)
        seeds[rows[seen], cols[seen]] = 0
        # Each pixel belongs to the nearest tip, and moves and grows with it; the bounds between two
        # tips follow.
        _, labels = cv2.distanceTransformWithLabels(
            seeds, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
        )
        tip_of = np.zeros(labels.max() + 1, np.int64)
        tip_of[labels[rows[seen], cols[seen]]] = np.flatnonzero(seen)
        tip = tip_of[labels]
        # What comes nearer to the lens is seen larger.
        scale = (far_mm / self._rest_mm).astype(np.float32)
        offset = (self._rest_px - px * scale[:, None]).astype(np.float32)
        moved = cv2.remap(
            self._moving,
            self._across * scale[tip] + offset[tip, 0],
            self._down * scale[tip] + offset[tip, 1],
            cv2.INTER_LINEAR,
        )
        return np.where(self._shown, moved, self._still)

    def _tips(self, skin: Skin) -> tuple[F64, F64]:
        """Where the tips appear, (N, 2), col and row, and their distance from the camera along its
        axis, in mm (1 for the orthographic camera, which shows everything at one scale).
        """
        marks = self.print
        pins = self._pins_on(skin, smoothed(skin, float(np.mean(marks.pin_base_mm))))
        tips = pins.base_mm - pins.normal * marks.pin_length_mm[:, None] + pins.lead_mm
        camera_mm = self.model.camera_distance_mm
        # Orthographic: nothing grows.
        far_mm = np.ones(len(tips)) if camera_mm is None else tips[:, 2] + camera_mm
        return project(self.model.geometry, tips), far_mm

    @staticmethod
    def _pixels(px: F64, size: tuple[int, ...]) -> tuple[I64, I64, Bool]:
        """Row and column of the tips' pixels, and which of them lie in the image."""
        cols, rows = np.rint(px).astype(np.int64).T
        seen = (rows >= 0) & (rows < size[0]) & (cols >= 0) & (cols < size[1])
        return rows, cols, np.asarray(seen)
