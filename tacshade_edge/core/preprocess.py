"""A frame up to the solver: is it valid, what is white, does anything touch (section IV-A of the paper)."""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.core import contact, greyscale
from tacshade_edge.core.disc import DiscRays, Grid, disc_mask, disc_rays
from tacshade_edge.core.profiles import Profile
from tacshade_edge.core.solvers.base import GreyMaps
from tacshade_edge.core.validity import frame_check, invalid_reason
from tacshade_edge.types import F32, U8, Bool, Calibration


class Preprocessor:
    """What every profile does first, and all that calibration needs of it.

    Parameters
    ----------
    calibration : Calibration
    profile : Profile
        Its stride, window and weight of the denoising; not its solver.
    """

    def __init__(self, calibration: Calibration, profile: Profile) -> None:
        geometry = calibration.geometry
        height, width = calibration.image_height_px, calibration.image_width_px
        self.calibration = calibration
        self.profile = profile
        self.sign = 1.0 if calibration.polarity == "bright" else -1.0
        self._window_px = greyscale.odd(profile.window_pitches * calibration.pitch_px)
        self.grid = Grid.of_image(height, width, profile.stride_px)
        self.rays: DiscRays = disc_rays(self.grid, geometry)
        mask = disc_mask(height, width, geometry.disc)
        self._mask: U8 = mask.astype(np.uint8)
        self._check = frame_check(calibration.reference_grey, mask, geometry.disc)
        self._glare_check = contact.glare_check(calibration.reference_grey, self._mask, calibration.pitch_px)
        self._total = greyscale.box_sums(self._mask, self._window_px, self.grid)
        self.voting: Bool = self.rays.inside & (
            self._total >= contact.GATE_WINDOW_PART * min(self._window_px**2, int(self._mask.sum()))
        )
        self.reference_ratio = greyscale.white_ratio(
            calibration.reference_white, self._total, self._window_px, self.grid, full_scale=1.0
        )
        self._g0 = greyscale.denoise_tv(self.reference_ratio, self.rays.inside, profile.tv_weight)
        self.cell_mm2 = (profile.stride_px * geometry.mm_per_px) ** 2

    def invalid_reason(self, image: U8) -> str:
        """Why an image cannot be used; empty for a good one."""
        return invalid_reason(greyscale.to_grey(image), self._check)

    def gate(self, g_raw: F32) -> contact.GateResult:
        """Whether anything touches, by eq. 9 of eq. 1."""
        g_d_raw = greyscale.grey_difference(g_raw, self.reference_ratio, self.rays.inside, self.sign)
        levels = self.profile.gate_levels
        return contact.gate(g_d_raw, self.voting, self.calibration.noise_grey, self.cell_mm2, levels)

    def touched(self, image: U8) -> bool:
        """Whether the contact gate opens for an image."""
        return self.gate(self.white_ratio(greyscale.to_grey(image))[1]).contact

    def grey_maps(self, image: U8) -> GreyMaps:
        """The maps that a solver would get from an image, without validity check and gate: for calibration."""
        _, g_raw, _ = self.white_ratio(greyscale.to_grey(image))
        g_d_raw = greyscale.grey_difference(g_raw, self.reference_ratio, self.rays.inside, self.sign)
        return self.denoised(g_raw, contact.light_drift(g_d_raw, self.voting))

    def denoised(self, g_raw: F32, drift_grey: float) -> GreyMaps:
        """TV denoising, then eq. 9 without the common change of light."""
        inside = self.rays.inside
        g = greyscale.denoise_tv(g_raw - np.float32(self.sign * drift_grey), inside, self.profile.tv_weight)
        g_d = greyscale.grey_difference(g, self._g0, inside, self.sign)
        return GreyMaps(g=g, g0=self._g0, g_d=g_d, inside=inside)

    def white_ratio(self, grey: U8) -> tuple[U8, F32, float]:
        """White pixels, eq. 1 of them without those under glare, and the part of the disc that these are."""
        calibration, mask, total, unseen = self.calibration, self._mask, self._total, 0.0
        glare = contact.glare_mask(grey, mask, self._glare_check)
        white = greyscale.binarise(grey, mask, calibration.binarisation, calibration.pitch_px)
        if glare is not None:
            clear = cv2.subtract(mask, glare)
            white = cv2.multiply(white, clear)
            # A network that sees black there would see pins; what stood there without contact says nothing.
            usual = (self.calibration.reference_white > 127).astype(np.uint8)
            shown = cv2.add(white, cv2.multiply(usual, glare))
            total = greyscale.box_sums(clear, self._window_px, self.grid)
            unseen = 1 - cv2.countNonZero(clear) / cv2.countNonZero(mask)
        g = greyscale.white_ratio(white, total, self._window_px, self.grid)
        if glare is not None:  # a window that sees next to nothing says nothing
            blind = total < 0.25 * self._total
            g = np.where(blind, self.reference_ratio, g).astype(np.float32)
            return shown, g, unseen
        return white, g, unseen
