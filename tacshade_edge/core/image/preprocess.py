"""A frame up to the solver: is it valid, what is white, does anything touch (section IV-A of the paper)."""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.core.contact import gate
from tacshade_edge.core.depth.base import GreyMaps
from tacshade_edge.core.frame_check.camera_shift import MovedCheck
from tacshade_edge.core.frame_check.validity import frame_check, invalid_reason
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.disc import DiscRays, Grid, Window, disc_mask, disc_rays
from tacshade_edge.core.image import greyscale
from tacshade_edge.core.image.binarise import Binariser, odd
from tacshade_edge.core.image.integral_image import Sums
from tacshade_edge.core.profiles import Profile
from tacshade_edge.types import F32, U8, Bool, Calibration


class Preprocessor:
    """What every profile does first, and all that calibration needs of it.

    Parameters
    ----------
    calibration : Calibration
    profile : Profile
        Its stride, window and weight of the denoising; not its solver.
    camera_px : int
        A pixel of the calibration is so many of the camera's.
    """

    def __init__(self, calibration: Calibration, profile: Profile, camera_px: int = 1) -> None:
        geometry = calibration.geometry
        height, width = calibration.image_height_px, calibration.image_width_px
        self.calibration = calibration
        self.profile = profile
        self.sign = 1.0 if calibration.polarity == "bright" else -1.0
        mask = disc_mask(height, width, geometry.disc)
        self._check = frame_check(calibration.reference_grey, mask, geometry.disc, camera_px)
        self._window = Window.of_disc(height, width, geometry.disc)
        self._mask: U8 = self._window.cut(mask.astype(np.uint8))
        self._binarise = Binariser(self._mask, calibration.binarisation, calibration.pitch_px)
        self._glare_check = gate.glare_check(
            self._window.cut(calibration.reference_grey), self._mask, calibration.pitch_px
        )
        self._side_px = odd(profile.window_pitches * calibration.pitch_px)
        self._sums = Sums(self._window, self._side_px // 2 + 1)
        self._cells = self._sums.cells_of(disc_map.map_grid(geometry.disc, profile.cells))
        fine = disc_map.map_grid(geometry.disc)
        self._fine_cells = self._cells if profile.cells == disc_map.CELLS else self._sums.cells_of(fine)
        self.grid = Grid.of_window(self._window, profile.stride_px)
        self.rays: DiscRays = disc_rays(self.grid, geometry)
        self._total = self._box_sums(self._mask)
        self.voting: Bool = self.rays.inside & (
            self._total >= gate.GATE_WINDOW_PART * min(self._side_px**2, int(self._mask.sum()))
        )
        self._voters = np.flatnonzero(self.voting)
        reference = self._window.cut(calibration.reference_white)
        self.reference_ratio = greyscale.white_ratio(self._box_sums(reference), self._total, full_scale=1.0)
        self._reference_voted: F32 = self.reference_ratio.take(self._voters)
        self._per_total: F32 = np.divide(np.float32(255), np.maximum(self._total, np.float32(1)))
        self.reference_cells: F32 = self._sums.means(self._cells) / np.float32(255)
        reference_fine: F32 = self._sums.means(self._fine_cells) / np.float32(255)
        self._moved = MovedCheck(reference_fine, camera_px * fine.step_px, camera_px * calibration.pitch_px)
        # A network that sees black under glare would see pins; what stood there without contact says nothing.
        self._usual = (reference > 127).astype(np.uint8)
        self._g0 = self._smooth(self.reference_ratio)
        self.cell_mm2 = (profile.stride_px * geometry.mm_per_px) ** 2

    def invalid_reason(self, image: U8) -> str:
        """Why an image cannot be used; empty for a good one."""
        return invalid_reason(greyscale.to_grey(image), self._check)

    def gate(self, g_raw: F32) -> gate.GateResult:
        """Whether anything touches, by eq. 9 of eq. 1."""
        levels, dark = self.profile.gate_levels, self.profile.gate_dark_levels
        return gate.gate(self._voted(g_raw), self.calibration.noise_grey, self.cell_mm2, levels, dark)

    def touched(self, image: U8) -> bool:
        """Whether the contact gate opens for an image."""
        return self.gate(self.white_ratio(greyscale.to_grey(image))[0]).contact

    def grey_maps(self, image: U8) -> GreyMaps:
        """The maps that a solver would get from an image, without validity check and gate: for calibration."""
        g_raw, _ = self.white_ratio(greyscale.to_grey(image))
        return self.denoised(g_raw, gate.light_drift(self._voted(g_raw)))

    def denoised(self, g_raw: F32, drift_grey: float) -> GreyMaps:
        """TV denoising, then eq. 9 without the common change of light."""
        inside = self.rays.inside
        g = self._smooth(g_raw - np.float32(self.sign * drift_grey))
        g_d = greyscale.grey_difference(g, self._g0, inside, self.sign)
        return GreyMaps(g=g, g0=self._g0, g_d=g_d, inside=inside)

    def white_ratio(self, grey: U8) -> tuple[F32, float]:
        """Eq. 1 of an image without what is under glare, and the part of the disc that this is.

        Returns
        -------
        g : float32 (rows, cols)
        unseen : float
        """
        window = self._window.cut(grey)
        glare = gate.glare_mask(window, self._glare_check)
        white = self._binarise(window)
        if glare is None:
            return self._box_sums(white) * self._per_total, 0.0
        clear = cv2.bitwise_and(self._mask, 1 - glare)
        total = self._box_sums(clear)
        g = greyscale.white_ratio(self._box_sums(cv2.bitwise_and(white, clear)), total)
        # A window that sees next to nothing says nothing.
        g = np.where(total < 0.25 * self._total, self.reference_ratio, g).astype(np.float32)
        self._sums.show(np.where(glare > 0, self._usual, white))
        return g, 1 - cv2.countNonZero(clear) / cv2.countNonZero(self._mask)

    def white_cells(self) -> F32:
        """White of the last image that `white_ratio` saw, for a network; under glare the reference's.

        Returns
        -------
        float32 (cells, cells), 0 to 1
        """
        return self._sums.means(self._cells)

    def moved_reason(self) -> str:
        """Whether the camera has moved since the reference, by the last image that `white_ratio` saw."""
        return self._moved.reason(self._sums.means(self._fine_cells))

    def _voted(self, g_raw: F32) -> F32:
        """Eq. 9 at the cells that have a vote, positive in contact: float32 (N,)."""
        change: F32 = g_raw.take(self._voters) - self._reference_voted
        return change if self.sign > 0 else -change

    def _smooth(self, g: F32) -> F32:
        profile = self.profile
        return greyscale.denoise_tv(g, self.rays.inside, profile.tv_weight, profile.tv_iterations, profile.tv_precision)

    def _box_sums(self, values: U8) -> F32:
        self._sums.show(values)
        return self._sums.boxes(self.grid, self._side_px)
