"""One frame to one reconstruction: reads as section IV of the paper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.contact import objects
from tacshade_edge.core.depth import SOLVERS, Depth
from tacshade_edge.core.depth.learned import DEEPEST_RADII, Inverse, LearnedInverse, Network
from tacshade_edge.core.frame_check.validity import size_reason
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.disc import DiscRays, Grid, cells_in_image, disc_rays
from tacshade_edge.core.image import greyscale
from tacshade_edge.core.image.halving import can_be_halved, grid_of_whole, halved_calibration, halved_image
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import LEARNED, Profile
from tacshade_edge.types import F32, U8, Bool, Calibration, Frame, HeightMap, ObjectCloud, Reconstruction

Mark = Callable[[str], None]

STAGES = ("check", "grey", "gate", "moved", "denoise", "depth", "cloud")
# A common change of g larger than the first is said; beyond the second the frame is another picture (focus, light).
DRIFT_LEVELS, DRIFT_INVALID_LEVELS = 12.0, 30.0
# In a contact that lasts, how often is asked whether the camera has moved.
MOVED_EVERY_NS = 100_000_000
# With more of the disc under glare than this, the rest says too little.
UNSEEN_INVALID = 0.4


def no_mark(stage: str) -> None:
    """Ignore a stage's end."""


def _learned(front: Preprocessor, network: Network | None) -> LearnedInverse | None:
    """The network prepared for the sensor, where the profile wants one."""
    calibration, profile = front.calibration, front.profile
    if profile.solver != LEARNED:
        return None
    if network is None:
        raise ValueError(f"profile {profile.name} needs a network")
    return LearnedInverse(network, calibration.geometry, calibration.pitch_px, front.reference_cells)


def _seen_rays(calibration: Calibration, grid: Grid) -> DiscRays:
    """Rays of a grid; what the image cuts off the disc is outside."""
    rays = disc_rays(grid, calibration.geometry)
    seen = cells_in_image(grid, calibration.image_height_px, calibration.image_width_px)
    return DiscRays(inside=rays.inside & seen, u=rays.u, v=rays.v)


@dataclass(frozen=True, slots=True, eq=False)
class Touched:
    """What is known of a frame in contact before its depth: eq. 1, the common change of light, why to trust it less."""

    g_raw: F32
    drift_grey: float
    degraded: str


class Reconstructor:
    """Turns frames of one calibrated sensor into reconstructions, deterministically.

    Parameters
    ----------
    calibration : Calibration
    profile : Profile
    network : Network, optional
        What a profile with the learned solver runs; ValueError where it is missing.
    region : callable
        Where objects are looked for (`clusters.find_objects`).
    """

    def __init__(
        self,
        calibration: Calibration,
        profile: Profile,
        network: Network | None = None,
        region: objects.Region = objects.bounding_box,
    ) -> None:
        self.calibration = calibration
        self._region = region
        self.profile = profile
        self._shape = (calibration.image_height_px, calibration.image_width_px)
        self._halve = profile.halved and can_be_halved(calibration)
        seen = halved_calibration(calibration) if self._halve else calibration
        self._front = Preprocessor(seen, profile, 2 if self._halve else 1)
        self._learned = _learned(self._front, network)
        self._asked_ns = -MOVED_EVERY_NS
        maps = grid_of_whole(self._front.grid) if self._halve else self._front.grid
        cells = disc_map.map_grid(calibration.geometry.disc, profile.cells)
        self._factor = np.float32(calibration.factors.get(profile.name, 1.0))
        self.grid = maps if self._learned is None else cells
        self.rays = _seen_rays(calibration, self.grid)
        # α is per pixel of the image (the paper ties it to the image's resolution).
        self._alpha_mm = calibration.alpha * calibration.geometry.mm_per_px
        zero = np.where(self.rays.inside, np.float32(0), np.float32(np.nan)).astype(np.float32)
        self._untouched = HeightMap(
            height_mm=zero,
            contact=np.zeros(zero.shape, dtype=bool),
            row0=self.grid.row0,
            col0=self.grid.col0,
            step_px=self.grid.step_px,
        )
        self._grey: U8 = np.empty((calibration.image_height_px, calibration.image_width_px), np.uint8)
        self._no_cloud = ObjectCloud(np.zeros((0, 3), dtype=np.float32), np.zeros(0, dtype=np.uint16))

    def step(self, frame: Frame, mark: Mark = no_mark) -> Reconstruction:
        """Reconstruct one frame.

        Parameters
        ----------
        frame : Frame
        mark : callable
            Called with a stage's name (`STAGES`) at its end; a caller with a clock times them so.
        """
        seen = self._look(frame, mark)
        return seen if isinstance(seen, Reconstruction) else self._solved(frame, seen, mark)

    def glance(self, frame: Frame, mark: Mark = no_mark) -> Reconstruction | None:
        """`step` as far as the contact's depth: its result for a frame that ends before, None for a contact's."""
        seen = self._look(frame, mark)
        return seen if isinstance(seen, Reconstruction) else None

    def _look(self, frame: Frame, mark: Mark) -> Reconstruction | Touched:
        """Is the frame valid, does anything touch, is the camera where it was?"""
        front = self._front
        reason = size_reason(frame.image, self._shape)
        grey = self._seen(frame.image)
        reason = reason or front.invalid_reason(grey)
        mark("check")
        if reason:
            return self._nothing(frame, reason=reason)

        g_raw, unseen = front.white_ratio(grey)
        degraded = f"glare: {100 * unseen:.0f} % of the disc unseen" if unseen > 0 else ""
        mark("grey")
        if unseen > UNSEEN_INVALID:
            return self._nothing(frame, reason=degraded)

        decision = front.gate(g_raw)
        if abs(decision.drift_grey) > DRIFT_LEVELS:
            degraded = f"light or focus: g moved by {decision.drift_grey:.0f} levels everywhere"
        mark("gate")
        if abs(decision.drift_grey) > DRIFT_INVALID_LEVELS:
            return self._nothing(frame, reason=degraded)
        if not decision.contact:
            return self._nothing(frame, degraded=degraded)
        reason = self._moved_reason(frame.t_ns)
        mark("moved")
        if reason:
            return self._nothing(frame, reason=reason)
        return Touched(g_raw, decision.drift_grey, degraded)

    def _solved(self, frame: Frame, seen: Touched, mark: Mark) -> Reconstruction:
        """Depth and objects of the frame that `_look` saw last."""
        front = self._front
        if self._learned is None:
            maps = front.denoised(seen.g_raw, seen.drift_grey)
            mark("denoise")
            depth, touched = SOLVERS[self.profile.solver](maps, self._alpha_mm), None
        else:
            mark("denoise")
            depth, touched = self._refitted(self._learned(front.white_cells()))
        mark("depth")

        result = self._objects(frame, depth, touched, seen.degraded)
        mark("cloud")
        return result

    def _moved_reason(self, t_ns: int) -> str:
        """Whether the camera has moved. A moved one opens the gate, so it is asked then, and now and then."""
        if 0 < t_ns - self._asked_ns < MOVED_EVERY_NS:
            return ""
        reason = self._front.moved_reason()
        self._asked_ns = -MOVED_EVERY_NS if reason else t_ns
        return reason

    def inverse(self, image: U8) -> Inverse:
        """What the network makes of an image, without validity check, gate and refit: for calibration."""
        if self._learned is None:
            raise ValueError(f"profile {self.profile.name} has no network")
        self._front.white_ratio(self._seen(image))
        return self._learned(self._front.white_cells())

    def _seen(self, image: U8) -> U8:
        """What is worked on of an image."""
        grey = greyscale.to_grey(image, self._grey)
        return halved_image(grey) if self._halve else grey

    def _refitted(self, inverse: Inverse) -> tuple[Depth, Bool]:
        """Refitted height and contact on the network's own cells."""
        height = inverse.height_mm * self._factor
        finite = np.isfinite(height)
        repaired = finite.size - int(np.count_nonzero(finite))
        if repaired:
            height = np.where(finite, height, np.float32(0))
        np.maximum(height, np.float32(0), out=height)
        touched: Bool = inverse.contact_logit > 0
        touched &= self.rays.inside
        deep = height > np.float32(DEEPEST_RADII * self.calibration.geometry.skin_radius_mm)
        deep &= touched
        return Depth(height, bool(deep.any()), repaired), touched

    def _objects(self, frame: Frame, depth: Depth, touched: Bool | None, degraded: str) -> Reconstruction:
        """Outline (the paper's split of heights where the solver gives none), metric points, clusters."""
        geometry, inside = self.calibration.geometry, self.rays.inside
        # Adding the map of no contact, 0 or NaN, puts NaN outside the disc.
        height = np.minimum(depth.height_mm, np.float32(geometry.skin_radius_mm)) + self._untouched.height_mm
        if touched is None:
            # Of the heights as found: cut off at the skin's radius, those of a great α would all be one.
            touched = inside & (depth.height_mm > objects.two_means_split(depth.height_mm[inside]))
        found = objects.find_objects(touched, height, self.rays, geometry, self._region)
        if found is None:
            return self._nothing(frame, degraded=degraded)
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
                contact=found.contact,
                row0=self.grid.row0,
                col0=self.grid.col0,
                step_px=self.grid.step_px,
            ),
            cloud=found.cloud,
            objects=found.described,
            volume_mm3=found.volume_mm3,
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
