"""A picture of a sensor, looked at once: what stages need of it is derived when one asks, and kept.

The judges and the gate see the same pictures in every profile; a network may see finer ones. Most
frames of an untouched skin show what an earlier one showed (`UnchangedSkin`).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import cv2
import numpy as np

from tacshade_edge.reasons import Reason
from tacshade_edge.sensor.contact.gate import ContactGate, gate_preprocessor
from tacshade_edge.sensor.frame_check import Judges, Measured, first_reason, picture, size_reason
from tacshade_edge.sensor.geometry.disc import Window
from tacshade_edge.sensor.image import greyscale
from tacshade_edge.sensor.image.preprocess import (
    LEAST_SIDE_PX,
    Preprocessed,
    Preprocessor,
    halved_image,
)
from tacshade_edge.sensor.image.white import median
from tacshade_edge.sensor.profiles import Profile
from tacshade_edge.types import F32, U8, Calibration, Disc

UNCHANGED_LEVELS = 8.0
"""Greatest change of a pixel under camera noise of 2 levels: means of 2x2 px differ by at most 6,
four deviations. A press that grows by a few hundredths of a millimetre changes more, so no contact
is found later.
"""
_AROUND = 1.35
"""Radii of the disc that are compared: as far out as the judge of the camera looks."""


class Eye:
    """What looks at one sensor's pictures in a profile, and the work space that its looks share.

    `own` prepares pictures for the profile's solver, `seen` those for judges and gate.
    """

    def __init__(self, calibration: Calibration, profile: Profile, *, with_network: bool) -> None:
        self.shape = (calibration.image_height_px, calibration.image_width_px)
        self.own = Preprocessor(calibration, profile)
        self.seen = seen = gate_preprocessor(calibration, self.own)
        grey, disc = seen.calibration.reference_grey, seen.calibration.geometry.disc
        plain_pitch_px = None if with_network else seen.calibration.pitch_px
        self.judges = Judges(grey, disc, plain_pitch_px, seen.camera_px)
        self.gate = ContactGate(seen)
        # A look writes into these, and the next look of the same eye overwrites them: no frame
        # allocates an image, and none may be kept without a copy.
        self.grey_space: U8 = np.empty(self.shape, np.uint8)
        self.seen_space = seen.integrator.space()
        shared = seen is self.own
        self.own_space = self.seen_space if shared else self.own.integrator.space()


class Look:
    """One picture, (H, W) or (H, W, 3) BGR; only the latest look of an eye may derive more.

    Nothing but `size_reason` may be asked of a picture that has another size than the sensor's.
    """

    def __init__(self, eye: Eye, image: U8) -> None:
        self._eye = eye
        self._image = image

    @cached_property
    def size_reason(self) -> Reason | None:
        """Why the picture's size is wrong."""
        return size_reason(self._image, self._eye.shape)

    @cached_property
    def _camera_grey(self) -> U8:
        return greyscale.to_grey(self._image, self._eye.grey_space)

    @cached_property
    def grey(self) -> U8:
        """The grey picture that judges and gate see."""
        return self._eye.seen.grey(self._camera_grey)

    @cached_property
    def judged(self) -> tuple[Measured, ...]:
        """What the judges measure of the grey picture; nothing after the first that refuses."""
        return self._eye.judges.measured(self.grey)

    @property
    def grey_reason(self) -> Reason | None:
        """Why the grey picture is refused."""
        # Every good frame passes, and needs none of the figures.
        return None if self._eye.judges.passes(self.grey) else first_reason(self.judged)

    @cached_property
    def white(self) -> Preprocessed:
        """The white that the gate sees."""
        return self._eye.seen.preprocess(self.grey, self._eye.seen_space)

    @cached_property
    def change_grey(self) -> F32:
        """The change of eq. 1 since the reference, at the cells that vote."""
        seen = self._eye.seen
        return seen.change_grey(seen.ratio(self.white.white))

    @cached_property
    def drift_grey(self) -> float:
        """The common change of eq. 1 since the reference."""
        return median(self.change_grey) if self.change_grey.size else 0.0

    @cached_property
    def is_clear(self) -> bool:
        """Whether what is measured of the white neither refuses nor degrades the picture."""
        change, limit = self.change_grey, np.float32(picture.DRIFT_LEVELS)
        # The median is within the limit where less than half is beyond it on each side, which is
        # counted faster than the median is found.
        few = max(change.size - 1, 0) // 2
        beyond = max(np.count_nonzero(change > limit), np.count_nonzero(change < -limit))
        return self.white.unseen == 0 and bool(beyond <= few)

    @cached_property
    def white_judged(self) -> tuple[Measured, ...]:
        """What is measured of the white: glare, and the common change."""
        return picture.white_measured(self.white.unseen, self.drift_grey)

    @cached_property
    def white_reason(self) -> Reason | None:
        """Why the white is refused."""
        return None if self.is_clear else first_reason(self.white_judged)

    @cached_property
    def degraded(self) -> Reason | None:
        """Why the picture is degraded, if it is not refused."""
        if self.is_clear:
            return None
        return picture.degraded_reason(self.white.unseen, self.drift_grey)

    @cached_property
    def changed_part(self) -> float:
        """The part of the picture that changed since the reference."""
        return self._eye.gate.changed_part(self.white)

    @cached_property
    def _least_changed_part(self) -> float:
        return self._eye.gate.least_changed_part(self.change_grey)

    def changes(self, part: float) -> bool:
        """Whether at least this part of the picture changed."""
        return self._least_changed_part >= part or self.changed_part >= part

    @cached_property
    def own_white(self) -> Preprocessed:
        """The white that the profile's solver sees."""
        eye = self._eye
        # Where the profile works on the gate's pictures, the disc is binarised once for both.
        if eye.own is eye.seen:
            return self.white
        return eye.own.preprocess(eye.own.grey(self._camera_grey), eye.own_space)

    @property
    def measured(self) -> tuple[Measured, ...]:
        """What judges measure without a network; nothing after the first that refuses."""
        # A black or torn picture has no white worth binarising.
        if first_reason(self.judged) is not None:
            return self.judged
        return self.judged + self.white_judged

    def lift(self) -> float:
        """`GlareFinder.lift` of the picture."""
        return self._eye.seen.lift(self._camera_grey)


class UnchangedSkin:
    """The latest untouched skin judged in full, and why it was `degraded`; it saves judging most
    frames: all judges give the same result. Frames are compared with that one, so slow changes add
    up.
    """

    def __init__(self, shape: tuple[int, ...], disc: Disc, *, halved: bool) -> None:
        # As far out as the judge of the camera looks, so that a moved surround is not taken for the
        # same picture.
        wide = Window.of_disc(shape[0], shape[1], replace(disc, radius_px=_AROUND * disc.radius_px))
        self._halved = halved or min(shape) < LEAST_SIDE_PX
        # Means over 2x2 px halve the camera's noise, so that the limit can be low; halved pictures
        # are such means already.
        per_px = 1 if self._halved else 2
        self._box = tuple(
            # -(a // -b) rounds up: no pixel of the box is lost to the halving.
            slice(first // per_px, -((first + size) // -per_px))
            for first, size in ((wide.row0, wide.rows), (wide.col0, wide.cols))
        )
        self._kept: U8 | None = None
        self.degraded: Reason | None = None

    def shown_in(self, grey: U8) -> bool:
        """Whether an image, uint8 (H, W), shows the same untouched skin."""
        return (
            # OpenCV's norm of uint8 takes the absolute difference; NumPy's would wrap around.
            self._kept is not None
            and cv2.norm(self._looked_at(grey), self._kept, cv2.NORM_INF) <= UNCHANGED_LEVELS
        )

    def keep(self, grey: U8, degraded: Reason | None) -> None:
        """Remember an image, uint8 (H, W), that was found valid and without contact."""
        shown = self._looked_at(grey)
        self._kept, self.degraded = (
            shown.copy() if shown.size else None,
            degraded,
        )  # some tiny images leave nothing

    def _looked_at(self, grey: U8) -> U8:
        return (grey if self._halved else halved_image(grey))[self._box]
