"""Prepare images for every solver: halve, blank out glare, binarise,
and make the maps of section IV-A.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import cv2
import numpy as np

from tacshade_edge.sensor.geometry.disc import DiscRays, Grid, Window, disc_mask, disc_rays
from tacshade_edge.sensor.image import greyscale
from tacshade_edge.sensor.image.white import (
    Binariser,
    BoxSums,
    Integrator,
    Total,
    halved,
    level_at,
    median,
    odd,
    padded,
)
from tacshade_edge.sensor.profiles import Profile
from tacshade_edge.types import F32, I32, U8, Bool, Calibration, Disc, frozen

# Cells do not vote if the rim cuts their window below this part of its full size:
# there a camera shift shows.
VOTING_WINDOW_PART = 0.75
# Weights of the reference shifted by a pixel back, not at all and forward, along each axis. More
# weight on the shifted ones makes the depth less exact if nothing shifted.
MOVED_PARTS = (1 / 8, 3 / 4, 1 / 8)
# Finer patterns are not halved: the networks have seen few pitches below 7 px.
LEAST_PITCH_PX = 14.0
# A smaller image has no mean over 2x2 px.
LEAST_SIDE_PX = 2
# A pixel of the reference's white, 0 to 255, beyond this was white in most of its images.
HALF_WHITE = 127
# Every box of this many pitches holds part of a black pin, in contact too (measured: 0.9 is
# enough), except under glare, where its darkest pixel exceeds the reference's by GLARE_LIFT and by
# GLARE_PART of the reference's range from dark to bright; another exposure lifts the dark less.
GLARE_PITCHES = 1.0
GLARE_LIFT, GLARE_PART = 22, 0.2
# Pixels are also glare if brighter than GLARE_GAIN times the brightest marker nearby in the
# reference plus GLARE_OFFSET; a drag moves markers by up to GLARE_REACH pitches to where the
# reference has none.
GLARE_GAIN, GLARE_OFFSET, GLARE_REACH = 1.3, 25, 2.0
GLARE_PX = 6
# Width of the halo around a glare spot that is not trusted either, in pitches (plus a block).
GLARE_HALO_PITCHES = 1.0


@frozen
class Preprocessed:
    """The disc's window, 0 and 1, with the reference's under glare; its integral;
    part of the disc under glare.
    """

    pixels: U8
    white: Total
    unseen: float


class Preprocessor:
    """Prepares images of one sensor for every solver, with a profile's resolution, stride and
    window. `camera` is the calibration in the camera's pixels, `calibration` in working pixels,
    which are twice as wide (`camera_px`) if the profile halves images; `grid` is that of eq. 1,
    `voting` its cells with most of their window in the disc.
    """

    def __init__(self, calibration: Calibration, profile: Profile) -> None:
        self.camera = calibration
        self.profile = profile
        self._halve = is_halved(calibration, profile)
        self.camera_px = 2 if self._halve else 1
        self.calibration = calibration = (
            halved_calibration(calibration) if self._halve else calibration
        )
        geometry, pitch_px = calibration.geometry, calibration.pitch_px
        height, width = calibration.image_height_px, calibration.image_width_px
        self.sign = 1.0 if calibration.polarity == "bright" else -1.0
        self.window = Window.of_disc(height, width, geometry.disc)
        self._mask: U8 = self.window.cut(disc_mask(height, width, geometry.disc).astype(np.uint8))
        self._binarise = Binariser(self._mask, calibration.binarisation, pitch_px)
        self._glare = GlareFinder(self.window.cut(calibration.reference_grey), self._mask, pitch_px)
        side_px = odd(profile.window_pitches * pitch_px)
        self.integrator = Integrator(self.window, side_px // 2 + 1)
        self.grid = Grid.of_window(self.window, profile.stride_px)
        self.rays: DiscRays = disc_rays(self.grid, geometry)
        self._box_sums = BoxSums(self.integrator, self.grid, side_px)
        total = self._box_sums.sums(self.integrator.integrate(self._mask))
        self._per_total: F32 = np.divide(np.float32(255), np.maximum(total, np.float32(1)))
        self.voting: Bool = self.rays.inside & (
            total >= VOTING_WINDOW_PART * min(side_px**2, int(self._mask.sum()))
        )
        self._voters = np.flatnonzero(self.voting)
        reference = self.window.cut(calibration.reference_white)
        self.reference_white = self.integrator.integrate(reference)
        self.reference_g: F32 = self.ratio(self.reference_white) / np.float32(255)
        self._reference_voted = self.voted(self.reference_g)
        self._reference_binary: U8 = (reference > HALF_WHITE).astype(np.uint8)
        self.cell_mm2 = (profile.stride_px * geometry.mm_per_px) ** 2

    @property
    def camera_grid(self) -> Grid:
        """`grid` in the camera's pixels."""
        grid = self.grid
        if not self._halve:
            return grid
        return Grid(
            grid.rows, grid.cols, 2 * grid.row0 + 0.5, 2 * grid.col0 + 0.5, 2 * grid.step_px
        )

    def grey(self, image: U8, space: U8 | None = None) -> U8:
        """Convert the camera's image, (H, W) or (H, W, 3) BGR, to the grey working image; it may
        use `space`, uint8 (H, W).
        """
        grey = greyscale.to_grey(image, space)
        return halved_image(grey) if self._halve else grey

    def binarised(self, grey: U8) -> U8:
        """Binarise the window of a grey working image, with any glare: 0 and 1."""
        return self._binarise(self.window.cut(grey)).copy()

    def preprocess(self, grey: U8, space: I32 | None = None) -> Preprocessed:
        """Binarise a grey working image without its glare; with `space`, from ``integrator.space``,
        the next call overwrites the result.
        """
        cut = self.window.cut(grey)
        glare = self._glare.mask(cut)
        white = self._binarise(cut)
        if glare is None:
            white, unseen = white if space is not None else white.copy(), 0.0
        else:
            # A network would take black under glare for pins; the reference's pixels are neutral.
            white = np.where(glare > 0, self._reference_binary, white)
            unseen = cv2.countNonZero(cv2.bitwise_and(self._mask, glare)) / max(
                cv2.countNonZero(self._mask), 1
            )
        return Preprocessed(white, self.integrator.integrate(white, space), unseen)

    def lift(self, image: U8) -> float:
        """`GlareFinder.lift` of the camera's image."""
        return self._glare.lift(self.window.cut(self.grey(image)))

    def ratio(self, white: Total) -> F32:
        """Eq. 1 on `grid`, ĝ = 255 s_w / s_t, from an integral of 0 and 1;
        only pixels of the disc count in both.
        """
        g: F32 = self._box_sums.sums(white) * self._per_total
        return g

    def voted(self, values: F32) -> F32:
        """The values at the cells that vote, (N,)."""
        return values.take(self._voters)

    def drift_grey(self, g: F32) -> float:
        """Median change of eq. 1 since the reference:
        a change of light affects every cell, a contact only some.
        """
        return median(self.change_grey(g)) if self._voters.size else 0.0

    def change_grey(self, g: F32) -> F32:
        """The change of eq. 1 since the reference, -255 to 255, at the cells that vote, (N,)."""
        return self.voted(g) - self._reference_voted


@frozen
class GreyMaps:
    """White ratio of an image and of the unloaded skin, denoised, 0 to 255; eq.
    9, positive in contact; the disc.
    """

    g: F32
    g0: F32
    g_d: F32
    inside: Bool

    def inverted(self) -> GreyMaps:
        """The maps of a sensor of the other polarity."""
        return replace(self, g_d=-self.g_d)


class GreyMapper:
    """Denoises white ratios, then applies eq. 9 without the common change of light."""

    def __init__(self, preprocessor: Preprocessor) -> None:
        self._preprocessor = preprocessor
        self._inside = preprocessor.rays.inside
        self._g0 = self._smooth(preprocessor.reference_g)

    def maps(self, preprocessed: Preprocessed) -> GreyMaps:
        """The maps of an image."""
        g = self._preprocessor.ratio(preprocessed.white)
        g = self._smooth(g - np.float32(self._preprocessor.drift_grey(g)))
        g_d = greyscale.grey_difference(g, self._g0, self._inside, self._preprocessor.sign)
        return GreyMaps(g=g, g0=self._g0, g_d=g_d, inside=self._inside)

    def _smooth(self, g: F32) -> F32:
        return greyscale.denoise_tv(g, self._inside, self._preprocessor.profile.tv_weight)


def is_halved(calibration: Calibration, profile: Profile) -> bool:
    """Whether a profile works on halved images of a sensor: its pattern must stay coarse enough.

    A network also sees a noisy camera halved (one that needs Otsu's level): it would take such
    noise in whole images for torn skin.
    """
    side_px = min(calibration.image_height_px, calibration.image_width_px)
    wanted = profile.halved or (profile.network is not None and calibration.binarisation == "otsu")
    return wanted and calibration.pitch_px >= LEAST_PITCH_PX and side_px >= LEAST_SIDE_PX


def halved_image(grey: U8) -> U8:
    """Means over 2x2 px, rounded half up, without the last row or column of an odd side;
    one of 1 px stays whole.
    """
    return (
        grey
        if min(grey.shape) < LEAST_SIDE_PX
        else halved(grey[: grey.shape[0] // 2 * 2, : grey.shape[1] // 2 * 2])
    )


def halved_calibration(calibration: Calibration) -> Calibration:
    """The calibration that halved images would give.

    Part of its white comes from the image shifted by a pixel, which pairs pixels differently;
    without it, a camera shifted by a pixel would look like less depth.
    """
    geometry = calibration.geometry
    at = geometry.disc
    # The middle of pixels (2i, 2i+1) is at 2i + 0.5.
    disc = Disc((at.row_c - 0.5) / 2, (at.col_c - 0.5) / 2, at.radius_px / 2)
    grey = halved_image(calibration.reference_grey)
    height, width = grey.shape
    pitch_px = calibration.pitch_px / 2
    # Binarise inside the disc's window, as for frames,
    # because the threshold's blocks start at its first pixel.
    window = Window.of_disc(height, width, disc)
    mask = window.cut(disc_mask(height, width, disc).astype(np.uint8))
    binariser = Binariser(mask, calibration.binarisation, pitch_px)
    white = np.zeros(grey.shape, np.float32)
    around = np.pad(calibration.reference_grey, 1, mode="edge")
    for (row, down), (col, across) in product(enumerate(MOVED_PARTS), repeat=2):
        moved = around[
            row : row + calibration.image_height_px, col : col + calibration.image_width_px
        ]
        window.cut(white)[...] += down * across * binariser(window.cut(halved_image(moved)))
    return replace(
        calibration,
        geometry=replace(geometry, disc=disc),
        image_height_px=height,
        image_width_px=width,
        pitch_px=pitch_px,
        reference_grey=grey,
        reference_white=np.rint(white * np.float32(255)).astype(np.uint8),
        alpha=calibration.alpha / 2,
    )


class GlareFinder:
    """Finds specular spots that the reference (in its window) does not have:
    they and their halo hide the skin.
    """

    def __init__(self, reference_grey: U8, mask: U8, pitch_px: float) -> None:
        # The search's blocks are at most a quarter of the pitch wide.
        self._side = next(side for side in (4, 2, 1) if side == 1 or side <= pitch_px / 4)
        opaque: U8 = np.multiply(mask, 255, dtype=np.uint8)
        self._inside = _most(opaque, self._side)
        # Neighbourhoods of blocks, as morphological kernels.
        self._box = _around(GLARE_PITCHES * pitch_px, self._side)
        self._halo = _around(2 * (GLARE_HALO_PITCHES * pitch_px + self._side), self._side)
        dark, bright = (level_at(reference_grey, opaque, part) for part in (0.01, 0.99))
        lift = max(GLARE_LIFT, round(GLARE_PART * (bright - dark)))
        self._dark = cv2.erode(_least(reference_grey, self._side), self._box)
        # Further inside, where no box reaches beyond the disc.
        self._middle = np.flatnonzero(cv2.erode(self._inside, self._box))
        lifted = self._dark + np.uint16(lift)
        self._darkest = np.minimum(lifted, 255).astype(np.uint8)
        reach = np.ones((2 * round(GLARE_REACH * pitch_px) + 1,) * 2, np.uint8)
        nearby = cv2.dilate(cv2.multiply(reference_grey, mask), reach)
        # Beyond the disc, glare does not matter.
        self._brightest: U8 = np.where(
            mask > 0,
            cv2.convertScaleAbs(nearby, alpha=GLARE_GAIN, beta=GLARE_OFFSET),
            np.uint8(255),
        )
        # Work space: whole blocks, white beyond the window; the window.
        self._whole = padded(np.full_like(mask, 255), self._side, 255)
        self._bright = np.empty_like(mask)

    def lift(self, grey: U8) -> float:
        """How many levels the darkest pixels of a place have risen more than those of most of the
        disc: light that is too faint to be found lifts them, a touch only moves them.
        """
        if not self._middle.size:
            return 0.0
        dark = cv2.erode(_least(padded(grey, self._side, 255), self._side), self._box)
        risen = dark.take(self._middle).astype(np.float32) - self._dark.take(self._middle)
        return float(risen.max()) - median(risen)

    def mask(self, grey: U8) -> U8 | None:
        """1 in glare and its halo, in whole blocks, of the window's grey image, uint8 (H, W);
        None without glare.
        """
        side, (rows, cols) = self._side, grey.shape
        self._whole[:rows, :cols] = grey
        found = cv2.compare(
            cv2.erode(_least(self._whole, side), self._box), self._darkest, cv2.CMP_GT
        )
        bright = cv2.compare(grey, self._brightest, cv2.CMP_GT, dst=self._bright)
        some = cv2.countNonZero(bright) >= GLARE_PX
        if not some and cv2.countNonZero(found) == 0:
            return None
        if some:
            found = cv2.bitwise_or(found, _most(bright, side))
        found = cv2.bitwise_and(found, self._inside)
        if cv2.countNonZero(found) == 0:
            return None
        grown = np.minimum(cv2.dilate(found, self._halo), 1)
        return np.ascontiguousarray(grown.repeat(side, axis=0).repeat(side, axis=1)[:rows, :cols])


def _around(size_px: float, block_px: int) -> U8:
    """A kernel of the smallest odd number of blocks that is at least this many pixels wide."""
    blocks = math.ceil(size_px / block_px)
    return np.ones((blocks + 1 - blocks % 2,) * 2, dtype=np.uint8)


def _least(image: U8, block_px: int) -> U8:
    """The darkest pixel of each block."""
    least = padded(image, block_px, 255)
    step = 1
    while step < block_px:
        least = np.asarray(cv2.min(least[::2], least[1::2]), np.uint8)
        least = np.asarray(
            cv2.min(least[:, :-step], least[:, step:]), np.uint8
        )  # over 2 step columns from each one
        step *= 2
    return np.ascontiguousarray(least[:, ::block_px])


def _most(image: U8, block_px: int) -> U8:
    """The brightest pixel of each block."""
    return np.asarray(cv2.bitwise_not(_least(cv2.bitwise_not(image), block_px)), np.uint8)
