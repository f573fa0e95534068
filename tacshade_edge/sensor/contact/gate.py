"""Save time on frames in which nothing touches: the gate decides nothing that a network would see.

Every profile has the same gate, on the same halved pictures. It asks how much of the skin's picture
changed, and closes only where a network would find nothing as deep as docs/results/limits.md
promises.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from tacshade_edge.sensor.geometry.disc import least_area_mm2
from tacshade_edge.sensor.image.preprocess import Preprocessed, Preprocessor
from tacshade_edge.sensor.profiles import GATE
from tacshade_edge.types import F32, U8, Calibration

GATE_PART, GATE_NOISE = 0.04, 6.0
"""Part of the pixels that must have changed to ask a network, beyond what the references show and
this many times their noise (of 255). The least change in which a network found 0.3 mm: 0.07 to
0.27. The most at rest: 0.01; warm-up 0.05, the dent that a release leaves 0.18, moved by 1 px 0.12
at 640x480 and 0.23 at 320x240.
"""
PLAIN_PART, PLAIN_NOISE = 0.13, 24.0  # the same, for a contact where no network decides
SURE_PART = 0.3  # part of the pixels beyond which no network need decide whether there is a contact
_ROUNDING = np.float32(0.01)  # levels by which float32 may err in a window
GATE_MM2 = 3.0  # least area of skin that has changed (`least_area_mm2`)


class ContactGate:
    """The gate of one sensor, with the preprocessor of its images (`gate_preprocessor`).

    `least_part`, `plain_part`: part of the pixels that must have changed for a network to look, and
    for a contact without one.
    """

    def __init__(self, preprocessor: Preprocessor) -> None:
        self._preprocessor = preprocessor
        self._reference: U8 = preprocessor.window.cut(preprocessor.calibration.reference_white)
        # A binary picture differs from the mean of several at the edges of markers: how much the
        # mean picture itself does is no change.
        at_rest = preprocessor.preprocess(np.asarray(preprocessor.calibration.reference_grey))
        self._space = preprocessor.integrator.space()
        self._own: F32 = self._windows(at_rest.pixels)
        self._own_grey = self._own + _ROUNDING
        # `noise_grey` is of eq. 1's g, 0 to 255; parts of pixels go to 1.
        noise = preprocessor.calibration.noise_grey / 255
        self.least_part = GATE_PART + GATE_NOISE * noise
        self.plain_part = PLAIN_PART + PLAIN_NOISE * noise
        least_mm2 = least_area_mm2(GATE_MM2, preprocessor.calibration.geometry)
        self._cells = max(math.ceil(least_mm2 / preprocessor.cell_mm2), 1)

    def changed_part(self, preprocessed: Preprocessed) -> float:
        """The part of the pixels that changed in the windows of at least `GATE_MM2` of skin."""
        return self._most_changed(self._windows(preprocessed.pixels) - self._own) / 255

    def least_changed_part(self, change_grey: F32) -> float:
        """A part of the pixels that `changed_part` is not below, much faster, from
        `Preprocessor.change_grey` of the same picture: a window's white changes by no more than its
        pixels do.
        """
        changed = np.abs(change_grey)
        changed -= self._own_grey
        return self._most_changed(changed) / 255

    def _most_changed(self, changed: F32) -> float:
        """The least changed cell of the most changed `GATE_MM2`: what a speck changes is smaller;
        overwrites what it gets.
        """
        if not changed.size:
            return 0.0
        # `partition` does not sort the rest.
        at = changed.size - min(self._cells, changed.size)
        changed.partition(at)
        return float(changed[at])

    def _windows(self, pixels: U8) -> F32:
        """How much the pixels of each voting cell's window differ from the reference, 0 to 255."""
        # The product first: OpenCV takes an array of four rows of one for a scalar.
        changed = cv2.absdiff(pixels * np.uint8(255), self._reference)
        preprocessor = self._preprocessor
        return preprocessor.voted(
            preprocessor.ratio(preprocessor.integrator.integrate(changed, self._space))
        ) / np.float32(255)


def gate_preprocessor(calibration: Calibration, own: Preprocessor) -> Preprocessor:
    """The preprocessor of the gate's images; `own`, the profile's, if it makes the same."""
    made = Preprocessor(calibration, GATE)
    # By what decides the pictures, not by name: a second preprocessor of the same pictures would
    # binarise every frame once more.
    same = (own.camera_px, own.profile.stride_px, own.profile.window_pitches)
    return own if same == (made.camera_px, GATE.stride_px, GATE.window_pitches) else made
