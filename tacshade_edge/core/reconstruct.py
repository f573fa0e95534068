"""One frame to one reconstruction: reads as section IV of the paper."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from tacshade_edge.core import clusters, contact, greyscale
from tacshade_edge.core.disc import DiscRays, Grid, disc_mask, disc_rays
from tacshade_edge.core.profiles import Profile
from tacshade_edge.core.skin import cell_area_mm2, skin_points
from tacshade_edge.core.solvers import SOLVERS, Depth, DepthScale, GreyMaps
from tacshade_edge.core.validity import frame_check, invalid_reason
from tacshade_edge.types import F32, U8, Bool, Calibration, Frame, HeightMap, ObjectCloud, Reconstruction

Mark = Callable[[str], None]

STAGES = ("check", "grey", "gate", "denoise", "depth", "cloud")
# A larger change of light than this is worth saying (grey levels of g).
DRIFT_LEVELS = 20.0


def no_mark(stage: str) -> None:
    """Ignore a stage's end."""


class Reconstructor:
    """Turns frames of one calibrated sensor into reconstructions, deterministically.

    Parameters
    ----------
    calibration : Calibration
    profile : Profile
    """

    def __init__(self, calibration: Calibration, profile: Profile) -> None:
        geometry = calibration.geometry
        height, width = calibration.image_height_px, calibration.image_width_px
        self.calibration = calibration
        self.profile = profile
        self._solve = SOLVERS[profile.solver]
        self._sign = 1.0 if calibration.polarity == "bright" else -1.0
        self._window_px = greyscale.odd(profile.window_pitches * calibration.pitch_px)
        self._grid = Grid.of_image(height, width, profile.stride_px)
        self._rays: DiscRays = disc_rays(self._grid, geometry)
        mask = disc_mask(height, width, geometry.disc)
        self._mask: U8 = mask.astype(np.uint8)
        self._check = frame_check(calibration.reference_grey, mask, geometry.disc)
        self._total = greyscale.box_sums(self._mask, self._window_px, self._grid)
        self._voting: Bool = self._rays.inside & (
            self._total >= contact.GATE_WINDOW_PART * min(self._window_px**2, int(self._mask.sum()))
        )
        self._g0_raw = greyscale.white_ratio(
            calibration.reference_white, self._total, self._window_px, self._grid, full_scale=1.0
        )
        self._g0 = greyscale.denoise_tv(self._g0_raw, self._rays.inside, profile.tv_weight)
        # α is per pixel of the image (the paper ties it to the image's resolution).
        self._scale = DepthScale(
            alpha_mm=calibration.alpha * geometry.mm_per_px,
            table_grey=calibration.table_grey,
            table_depth_mm=calibration.table_depth_mm,
        )
        self._cell_mm2 = (profile.stride_px * geometry.mm_per_px) ** 2
        zero = np.where(self._rays.inside, np.float32(0), np.float32(np.nan)).astype(np.float32)
        self._untouched = HeightMap(
            height_mm=zero,
            contact=np.zeros(zero.shape, dtype=bool),
            row0=self._grid.row0,
            col0=self._grid.col0,
            step_px=self._grid.step_px,
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

        g_raw, degraded = self._white_ratio(grey)
        mark("grey")

        g_d_raw = greyscale.grey_difference(g_raw, self._g0_raw, self._rays.inside, self._sign)
        decision = contact.gate(g_d_raw, self._voting, self.calibration.noise_grey, self._cell_mm2)
        if abs(decision.drift_grey) > DRIFT_LEVELS:
            degraded = f"light: g moved by {decision.drift_grey:.0f} levels everywhere"
        mark("gate")
        if not decision.contact:
            return self._nothing(frame, degraded=degraded)

        g = greyscale.denoise_tv(g_raw, self._rays.inside, self.profile.tv_weight)
        mark("denoise")

        g_d = greyscale.grey_difference(g - self._sign * decision.drift_grey, self._g0, self._rays.inside, self._sign)
        depth = self._solve(GreyMaps(g=g, g0=self._g0, g_d=g_d, inside=self._rays.inside), self._scale)
        mark("depth")

        result = self._objects(frame, depth, degraded)
        mark("cloud")
        return result

    def _white_ratio(self, grey: U8) -> tuple[F32, str]:
        """Eq. 1, without the pixels under glare; and the reason for less trust."""
        calibration, mask, total, degraded = self.calibration, self._mask, self._total, ""
        glare = contact.glare_mask(grey, mask, calibration.pitch_px)
        white = greyscale.binarise(grey, mask, calibration.binarisation, calibration.pitch_px)
        if glare is not None:
            clear = cv2.subtract(mask, glare)
            white = cv2.multiply(white, clear)
            total = greyscale.box_sums(clear, self._window_px, self._grid)
            degraded = f"glare: {100 * (1 - cv2.countNonZero(clear) / cv2.countNonZero(mask)):.0f} % of the disc unseen"
        g = greyscale.white_ratio(white, total, self._window_px, self._grid)
        if glare is not None:  # a window that sees next to nothing says nothing
            blind = total < 0.25 * self._total
            g = np.where(blind, self._g0_raw, g).astype(np.float32)
        return g, degraded

    def _objects(self, frame: Frame, depth: Depth, degraded: str) -> Reconstruction:
        """Outline, metric points, clusters."""
        inside = self._rays.inside
        height = np.minimum(depth.height_mm, np.float32(self.calibration.geometry.skin_radius_mm))
        height = np.where(inside, height, np.float32(np.nan)).astype(np.float32)
        split = clusters.two_means_split(height[inside])
        points, _ = skin_points(height, self._rays, self.calibration.geometry)
        area = cell_area_mm2(points)
        labels = clusters.label_objects(inside & (np.nan_to_num(height) > split), area)
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
                row0=self._grid.row0,
                col0=self._grid.col0,
                step_px=self._grid.step_px,
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
