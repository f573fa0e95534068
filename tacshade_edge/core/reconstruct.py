"""One frame to one reconstruction: reads as section IV of the paper."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from tacshade_edge.core import clusters, contact, discmap, greyscale
from tacshade_edge.core.disc import DiscRays, Grid, disc_mask, disc_rays, radius_squared
from tacshade_edge.core.profiles import Profile
from tacshade_edge.core.refit import apply_refit
from tacshade_edge.core.skin import cell_area_mm2, skin_points
from tacshade_edge.core.solvers import LEARNED, SOLVERS, Depth, DepthScale, GreyMaps, fast
from tacshade_edge.core.solvers.accurate import DEEPEST_RADII, Inverse, LearnedInverse, Network
from tacshade_edge.core.validity import frame_check, invalid_reason
from tacshade_edge.types import F32, U8, Bool, Calibration, Disc, Frame, HeightMap, ObjectCloud, Reconstruction

Mark = Callable[[str], None]

STAGES = ("check", "grey", "gate", "denoise", "depth", "cloud")
# A common change of g larger than the first is said; beyond the second the frame is another picture (focus, light).
DRIFT_LEVELS, DRIFT_INVALID_LEVELS = 12.0, 30.0
# With more of the disc under glare than this, the rest says too little.
UNSEEN_INVALID = 0.4


def no_mark(stage: str) -> None:
    """Ignore a stage's end."""


def radial_gain(table: F32, grid: Grid, disc: Disc) -> F32:
    """`Calibration.table_gain` at every cell of a grid; empty for an empty table."""
    if table.size == 0:
        return np.zeros((0, 0), dtype=np.float32)
    knots = np.linspace(0, 1, table.size)
    gain: F32 = np.interp(radius_squared(grid, disc), knots, table).astype(np.float32)
    return gain


def _learned(calibration: Calibration, profile: Profile, network: Network | None) -> LearnedInverse | None:
    """The network prepared for the sensor, where the profile wants one."""
    if profile.solver != LEARNED:
        return None
    if network is None:
        raise ValueError(f"profile {profile.name} needs a network")
    return LearnedInverse(network, calibration.geometry, calibration.pitch_px, calibration.reference_white)


class Reconstructor:
    """Turns frames of one calibrated sensor into reconstructions, deterministically.

    Parameters
    ----------
    calibration : Calibration
    profile : Profile
    network : Network, optional
        What a profile with the learned solver runs; ValueError where it is missing.
    """

    def __init__(self, calibration: Calibration, profile: Profile, network: Network | None = None) -> None:
        geometry = calibration.geometry
        height, width = calibration.image_height_px, calibration.image_width_px
        self.calibration = calibration
        self.profile = profile
        self._learned = _learned(calibration, profile, network)
        self._sign = 1.0 if calibration.polarity == "bright" else -1.0
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
        # α is per pixel of the image (the paper ties it to the image's resolution).
        self.scale = DepthScale(
            alpha_mm=calibration.alpha * geometry.mm_per_px,
            table_grey=calibration.table_grey,
            table_depth_mm=calibration.table_depth_mm,
            gain=radial_gain(calibration.table_gain, self.grid, geometry.disc),
            reach_cells=fast.REACH_RADII * geometry.skin_radius_mm / (profile.stride_px * geometry.mm_per_px),
        )
        self._cell_mm2 = (profile.stride_px * geometry.mm_per_px) ** 2
        zero = np.where(self.rays.inside, np.float32(0), np.float32(np.nan)).astype(np.float32)
        self._untouched = HeightMap(
            height_mm=zero,
            contact=np.zeros(zero.shape, dtype=bool),
            row0=self.grid.row0,
            col0=self.grid.col0,
            step_px=self.grid.step_px,
        )
        self._no_cloud = ObjectCloud(np.zeros((0, 3), dtype=np.float32), np.zeros(0, dtype=np.uint16))

    def step(self, frame: Frame, mark: Mark = no_mark) -> Reconstruction:
        """Reconstruct one frame.

        Parameters
        ----------
        frame : Frame
        mark : callable
            Called with a stage's name (`STAGES`) at its end; a caller with a clock times them so.
        """
        grey = greyscale.to_grey(frame.image)
        reason = invalid_reason(grey, self._check)
        mark("check")
        if reason:
            return self._nothing(frame, reason=reason)

        white, g_raw, unseen = self._white_ratio(grey)
        degraded = f"glare: {100 * unseen:.0f} % of the disc unseen" if unseen > 0 else ""
        mark("grey")
        if unseen > UNSEEN_INVALID:
            return self._nothing(frame, reason=degraded)

        g_d_raw = greyscale.grey_difference(g_raw, self.reference_ratio, self.rays.inside, self._sign)
        decision = contact.gate(g_d_raw, self.voting, self.calibration.noise_grey, self._cell_mm2)
        if abs(decision.drift_grey) > DRIFT_LEVELS:
            degraded = f"light or focus: g moved by {decision.drift_grey:.0f} levels everywhere"
        mark("gate")
        if abs(decision.drift_grey) > DRIFT_INVALID_LEVELS:
            return self._nothing(frame, reason=degraded)
        if not decision.contact:
            return self._nothing(frame, degraded=degraded)

        if self._learned is None:
            maps = self._denoised(g_raw, decision.drift_grey)
            mark("denoise")
            depth, touched = SOLVERS[self.profile.solver](maps, self.scale), None
        else:
            mark("denoise")
            depth, touched = self._run_learned(self._learned, white)
        mark("depth")

        result = self._objects(frame, depth, touched, degraded)
        mark("cloud")
        return result

    def invalid_reason(self, image: U8) -> str:
        """Why an image cannot be used; empty for a good one."""
        return invalid_reason(greyscale.to_grey(image), self._check)

    def touched(self, image: U8) -> bool:
        """Whether the contact gate opens for an image."""
        _, g_raw, _ = self._white_ratio(greyscale.to_grey(image))
        g_d_raw = greyscale.grey_difference(g_raw, self.reference_ratio, self.rays.inside, self._sign)
        return contact.gate(g_d_raw, self.voting, self.calibration.noise_grey, self._cell_mm2).contact

    def grey_maps(self, image: U8) -> GreyMaps:
        """The maps that the solver would get from an image, without validity check and gate: for calibration."""
        _, g_raw, _ = self._white_ratio(greyscale.to_grey(image))
        g_d_raw = greyscale.grey_difference(g_raw, self.reference_ratio, self.rays.inside, self._sign)
        return self._denoised(g_raw, contact.light_drift(g_d_raw, self.voting))

    def inverse(self, image: U8) -> Inverse:
        """What the network makes of an image, without validity check, gate and refit: for calibration."""
        if self._learned is None:
            raise ValueError(f"profile {self.profile.name} has no network")
        return self._learned(self._white_ratio(greyscale.to_grey(image))[0])

    @property
    def known(self) -> F32:
        """What the network is told of the sensor (`discmap.geometry_maps`)."""
        if self._learned is None:
            raise ValueError(f"profile {self.profile.name} has no network")
        return self._learned.known

    def _run_learned(self, learned: LearnedInverse, white: U8) -> tuple[Depth, Bool]:
        """Refitted height and contact on the grid."""
        disc = self.calibration.geometry.disc
        inverse = learned(white)
        refitted = apply_refit(self.calibration.refit, inverse.height_mm, learned.known)
        finite = np.isfinite(refitted)
        height = np.maximum(discmap.at_grid(np.where(finite, refitted, np.float32(0)), disc, self.grid), 0)
        height = np.where(self.rays.inside, height, np.float32(0)).astype(np.float32)
        touched: Bool = (discmap.at_grid(inverse.contact_logit, disc, self.grid) > 0) & self.rays.inside
        deepest = DEEPEST_RADII * self.calibration.geometry.skin_radius_mm
        saturated = bool(height[touched].max(initial=0.0) > deepest)
        return Depth(height, saturated, int(finite.size - np.count_nonzero(finite))), touched

    def _denoised(self, g_raw: F32, drift_grey: float) -> GreyMaps:
        """TV denoising, then eq. 9 without the common change of light."""
        inside = self.rays.inside
        g = greyscale.denoise_tv(g_raw - np.float32(self._sign * drift_grey), inside, self.profile.tv_weight)
        g_d = greyscale.grey_difference(g, self._g0, inside, self._sign)
        return GreyMaps(g=g, g0=self._g0, g_d=g_d, inside=inside)

    def _white_ratio(self, grey: U8) -> tuple[U8, F32, float]:
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

    def _objects(self, frame: Frame, depth: Depth, touched: Bool | None, degraded: str) -> Reconstruction:
        """Outline (the paper's split of heights where the solver gives none), metric points, clusters."""
        inside = self.rays.inside
        height = np.minimum(depth.height_mm, np.float32(self.calibration.geometry.skin_radius_mm))
        height = np.where(inside, height, np.float32(np.nan)).astype(np.float32)
        if touched is None:
            touched = inside & (np.nan_to_num(height) > clusters.two_means_split(height[inside]))
        points, _ = skin_points(height, self.rays, self.calibration.geometry)
        area = cell_area_mm2(points)
        labels = clusters.label_objects(touched, area)
        objects = clusters.describe_objects(labels, points, height, area)
        if not objects:
            return self._nothing(frame, degraded=degraded)
        touched = labels > 0
        return Reconstruction(
            seq=frame.seq,
            t_ns=frame.t_ns,
            wall_ns=frame.wall_ns,
            profile=self.profile.name,
            valid=True,
            reason="",
            contact=True,
            saturated=depth.saturated,
            degraded=degraded,
            height=HeightMap(
                height_mm=height,
                contact=touched,
                row0=self.grid.row0,
                col0=self.grid.col0,
                step_px=self.grid.step_px,
            ),
            cloud=clusters.object_cloud(labels, points),
            objects=objects,
            volume_mm3=float(np.nansum((height * area)[touched])),
            repaired_px=depth.repaired_px,
        )

    def _nothing(self, frame: Frame, reason: str = "", degraded: str = "") -> Reconstruction:
        """No contact, or no valid frame: exactly 0 inside the disc."""
        return Reconstruction(
            seq=frame.seq,
            t_ns=frame.t_ns,
            wall_ns=frame.wall_ns,
            profile=self.profile.name,
            valid=not reason,
            reason=reason,
            contact=False,
            saturated=False,
            degraded=degraded,
            height=self._untouched,
            cloud=self._no_cloud,
        )
