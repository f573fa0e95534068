"""Compute the white ratio (eq. 1) and its change (eq. 9) from an image: section IV-A of the paper."""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.core.geometry.disc import DiscRays, Grid, Window, disc_mask, disc_rays
from tacshade_edge.core.image import greyscale
from tacshade_edge.core.image.binarise import Binariser, odd
from tacshade_edge.core.image.glare import glare_check, glare_mask
from tacshade_edge.core.image.halving import grid_of_whole, halved_calibration, halved_image, is_halved
from tacshade_edge.core.image.integral_image import BoxSums, IntegralImage, Integrator
from tacshade_edge.core.image.median import median
from tacshade_edge.core.profiles import Profile
from tacshade_edge.types import F32, I32, U8, Bool, Calibration, frozen

# Cells do not vote if the rim cuts their window below this part of its full size: there a camera shift shows.
VOTING_WINDOW_PART = 0.75
# A window shows nothing if glare leaves less than this part of it.
CLEAR_WINDOW_PART = 0.25


@frozen
class Preprocessed:
    """The result of preprocessing an image.

    Attributes
    ----------
    g : float32 (rows, cols), 0 to 255
        Eq. 1 on `Preprocessor.grid`; the reference's value under glare.
    g_d : float32 (N,)
        Eq. 9 at the voting cells, positive in contact, not denoised.
    drift_grey : float
        Median of `g_d`, grey levels: a change of light affects every cell, a contact only some.
    white : IntegralImage
        Integral of the binarised image, 0 and 1; the reference's pixels under glare.
    unseen : float
        Part of the disc under glare, 0 to 1.
    """

    g: F32
    g_d: F32
    drift_grey: float
    white: IntegralImage
    unseen: float


class Preprocessor:
    """Prepares images of one sensor for every solver.

    Parameters
    ----------
    calibration : Calibration
    profile : Profile
        Provides resolution, stride and window; its solver does not matter.

    Attributes
    ----------
    camera : Calibration
        The calibration as given, in the camera's pixels.
    calibration : Calibration
        The calibration in working pixels: the camera's, or twice as wide if the profile halves images.
    camera_px : int
        Width of a working pixel in the camera's pixels.
    profile : Profile
    sign : float
        -1 for a sensor that darkens in contact, else 1.
    integrator : Integrator
        Computes `Preprocessed.white`.
    grid : Grid
        Grid of `Preprocessed.g`, in working pixels.
    rays : DiscRays
        Rays of `grid`.
    voting : bool (rows, cols)
        Cells of `Preprocessed.g_d`: most of their window lies in the disc.
    reference_g : float32 (rows, cols), 0 to 255
        Eq. 1 of the unloaded skin.
    reference_white : IntegralImage
        Integral of the unloaded skin's `Calibration.reference_white`, 0 to 255.
    cell_mm2 : float
        Area of skin that a cell of `grid` covers.
    """

    def __init__(self, calibration: Calibration, profile: Profile) -> None:
        self.camera = calibration
        self.profile = profile
        self._halve = is_halved(calibration, profile)
        self.camera_px = 2 if self._halve else 1
        self.calibration = calibration = halved_calibration(calibration) if self._halve else calibration
        geometry, pitch_px = calibration.geometry, calibration.pitch_px
        height, width = calibration.image_height_px, calibration.image_width_px
        self.sign = 1.0 if calibration.polarity == "bright" else -1.0
        self._window = Window.of_disc(height, width, geometry.disc)
        self._mask: U8 = self._window.cut(disc_mask(height, width, geometry.disc).astype(np.uint8))
        self._binarise = Binariser(self._mask, calibration.binarisation, pitch_px)
        self._glare_check = glare_check(self._window.cut(calibration.reference_grey), self._mask, pitch_px)
        side_px = odd(profile.window_pitches * pitch_px)
        self.integrator = Integrator(self._window, side_px // 2 + 1)
        self.grid = Grid.of_window(self._window, profile.stride_px)
        self.rays: DiscRays = disc_rays(self.grid, geometry)
        self._box_sums = BoxSums(self.integrator, self.grid, side_px)
        self._total = self._box_sums.sums(self.integrator.integrate(self._mask))
        self._per_total: F32 = np.divide(np.float32(255), np.maximum(self._total, np.float32(1)))
        self.voting: Bool = self.rays.inside & (
            self._total >= VOTING_WINDOW_PART * min(side_px**2, int(self._mask.sum()))
        )
        self._voters = np.flatnonzero(self.voting)
        reference = self._window.cut(calibration.reference_white)
        self.reference_white = self.integrator.integrate(reference)
        self.reference_g = greyscale.white_ratio(self._box_sums.sums(self.reference_white), self._total, full_scale=1.0)
        self._reference_voted: F32 = self.reference_g.take(self._voters)
        self._reference_binary: U8 = (reference > 127).astype(np.uint8)
        self.cell_mm2 = (profile.stride_px * geometry.mm_per_px) ** 2

    @property
    def camera_grid(self) -> Grid:
        """`grid` in the camera's pixels."""
        return grid_of_whole(self.grid) if self._halve else self.grid

    def grey(self, image: U8, space: U8 | None = None) -> U8:
        """Convert the camera's image to the grey working image.

        Parameters
        ----------
        image : uint8 (H, W) or (H, W, 3) BGR
        space : uint8 (H, W), optional
            Buffer that the result may use, valid until `space` is used again.
        """
        grey = greyscale.to_grey(image, space)
        return halved_image(grey) if self._halve else grey

    def preprocess(self, grey: U8, space: I32 | None = None) -> Preprocessed:
        """Binarise, then apply eqs. 1 and 9 without the pixels under glare.

        Parameters
        ----------
        grey : uint8 (H, W)
            From `grey`.
        space : int32, optional
            Buffer from ``integrator.space`` that `Preprocessed.white` may use, valid until `space` is used again.
        """
        window = self._window.cut(grey)
        glare = glare_mask(window, self._glare_check)
        white = self._binarise(window)
        if glare is None:
            integral = self.integrator.integrate(white, space)
            g, unseen = self._box_sums.sums(integral) * self._per_total, 0.0
        else:
            g, unseen = self._ratio_beside(glare, white)
            # A network would take black under glare for pins; the reference's pixels are neutral.
            integral = self.integrator.integrate(np.where(glare > 0, self._reference_binary, white), space)
        g_d = g.take(self._voters) - self._reference_voted
        g_d = g_d if self.sign > 0 else -g_d
        return Preprocessed(g, g_d, median(g_d) if g_d.size else 0.0, integral, unseen)

    def _ratio_beside(self, glare: U8, white: U8) -> tuple[F32, float]:
        """Eq. 1 of the pixels not under glare, and the part of the disc under glare."""
        clear = cv2.bitwise_and(self._mask, 1 - glare)
        total = self._box_sums.sums(self.integrator.integrate(clear))
        white_clear = self.integrator.integrate(cv2.bitwise_and(white, clear))
        g = greyscale.white_ratio(self._box_sums.sums(white_clear), total)
        g = np.where(total < CLEAR_WINDOW_PART * self._total, self.reference_g, g).astype(np.float32)
        return g, 1 - cv2.countNonZero(clear) / cv2.countNonZero(self._mask)
