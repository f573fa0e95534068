"""Check one press: can `calibrate` use its image, what does a network see in it,
and does that differ from its row?
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode, finding
from tacshade_edge.calibration.indenters import ball_along, ball_height_along, known_height
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.observation import PressObservation, observe_press
from tacshade_edge.calibration.quality import GRADED_PROFILE
from tacshade_edge.calibration.reference.references import PROFILE
from tacshade_edge.calibration.refit import LEAST_CELLS, contact_direction
from tacshade_edge.reasons import Reason
from tacshade_edge.sensor.contact.gate import ContactGate
from tacshade_edge.sensor.depth import Network
from tacshade_edge.sensor.depth.learned import Inverse, LearnedSolver
from tacshade_edge.sensor.frame_check import camera_drift, plain_judges
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import disc_rays, skin_points
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.sensor.image.preprocess import GreyMapper, GreyMaps, Preprocessor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import F32, F64, U8, Bool, Calibration, Geometry

# Radii to try, as multiples of the stated one, which is in the middle; and the floor for a misfit.
_LEAST_MISFIT = 1e-3
_TRIED = np.exp(np.linspace(math.log(0.25), math.log(4.0), 49))
# Ratios of shown to stated radii are within these on ten simulated sensors of two kinds, if stated
# right. A larger look counts only if the stated radius fits this many times worse; shallower
# presses (mm, nominal skin) do not show it.
_LOOKS, _LOOKS_RATIO, _LOOKS_DEPTH_MM = (0.7, 1.7), 3.0, 0.8


def _contact(inverse: Inverse) -> Bool:
    return np.asarray((inverse.contact_logit > 0) & np.isfinite(inverse.height_mm))


def _indenter_place(inverse: Inverse, geometry: Geometry, press: KnownPress) -> tuple[float, float]:
    """The stated place, shifted by the difference between the centroids of the heights
    and the indenter's surface.
    """
    placed = press.placed(geometry.skin_radius_mm)
    x_mm, y_mm = _middle(
        np.where(_contact(inverse), inverse.height_mm, np.float32(0)), geometry
    ).tolist()
    # An indenter's middle is not its origin, so its surface is compared at the stated place.
    under: F32 = np.maximum(
        np.nan_to_num(known_height(geometry, placed, len(inverse.height_mm))), np.float32(0)
    )
    if np.count_nonzero(under) < LEAST_CELLS:
        return x_mm, y_mm
    under_x, under_y = _middle(under, geometry).tolist()
    return (press.x_mm or 0.0) + x_mm - under_x, (press.y_mm or 0.0) + y_mm - under_y


def _middle(height_mm: F32, geometry: Geometry) -> F64:
    """Mean x and y of the skin where its height is above 0, weighted by the height; mm."""
    height = np.maximum(height_mm, np.float32(0))
    rays = disc_rays(disc_map.map_grid(geometry.disc, len(height)), geometry)
    use = (height > 0) & rays.inside
    points = skin_points(height, rays, geometry)[use].astype(np.float64)
    return (
        np.asarray(np.average(points[:, :2], axis=0, weights=height[use]))
        if use.any()
        else np.zeros(2)
    )


def _misfits(inverse: Inverse, geometry: Geometry, along: F64, press: KnownPress) -> list[float]:
    """For each radius tried, the part of the squared heights in the contact
    that its surface does not explain.
    """
    rays = disc_rays(disc_map.map_grid(geometry.disc, len(inverse.height_mm)), geometry)
    use = _contact(inverse)
    found, inside = inverse.height_mm[use].astype(np.float64), rays.inside[use]
    u, v = rays.u[use].astype(np.float64), rays.v[use].astype(np.float64)
    misfits = []
    for part in _TRIED:
        ball = ball_along(geometry.skin_radius_mm, along, press.depth_mm, part * press.radius_mm)
        height = ball_height_along(geometry, ball, u, v)
        known = np.where(inside & (height > 0), height, 0).astype(np.float32).astype(np.float64)
        # The squared cosine: a factor on the heights, which the network may have, does not count.
        likeness = float(found @ known) ** 2 / max(
            float(found @ found) * float(known @ known), np.finfo(float).tiny
        )
        misfits.append(1 - likeness)
    return misfits


@dataclass(frozen=True, slots=True)
class Judgement:
    """Why an image of a press cannot be used; or what moved too far since the references,
    and what changed less.
    """

    unusable: Reason | None
    moved: Reason | None = None
    changed: Reason | None = None
    in_contact: bool = False


class PressCheck:
    """Judges and measures images of one sensor from its calibration without presses,
    and a network of its own.
    """

    def __init__(self, unloaded: Calibration, network: Network | None = None) -> None:
        self.geometry = unloaded.geometry
        self.preprocessor = Preprocessor(unloaded, PROFILE)
        self.mapper = GreyMapper(self.preprocessor)
        self.gate = ContactGate(self.preprocessor)
        self._judges = plain_judges(unloaded)
        self._reference = camera_drift.look(
            unloaded.reference_grey, unloaded.geometry.disc, unloaded.pitch_px
        )
        # Two preprocessors: χ needs whole images without a network, the network its own grid.
        self.seen = Preprocessor(unloaded, PROFILES[GRADED_PROFILE])
        self.solver = LearnedSolver(self.seen, network) if network else None

    def look(self, image: U8) -> PressLook:
        """Look at an image (H, W) or (H, W, 3)."""
        return PressLook(self, image)

    def see(
        self, look: PressLook, observed: PressObservation, press: KnownPress
    ) -> PressObservation:
        """The observation with what the network sees;
        unchanged without a network, or if it sees no contact.
        """
        inverse, geometry = look.inverse, self.geometry
        if inverse is None:
            return observed
        seen = replace(
            observed, seen_depth_mm=float(inverse.height_mm[_contact(inverse)].max()), reach_mm=0.0
        )
        if press.indenter is not None:
            x_mm, y_mm = _indenter_place(inverse, geometry, press)
            return replace(seen, located_x_mm=x_mm, located_y_mm=y_mm)
        along = contact_direction(geometry, inverse)
        if along is None:
            return observed
        ball = ball_along(geometry.skin_radius_mm, along, press.depth_mm, press.radius_mm)
        misfits = _misfits(inverse, geometry, along, press)
        best, stated = int(np.argmin(misfits)), misfits[len(_TRIED) // 2]
        ratio = max(stated / max(misfits[best], _LEAST_MISFIT), 1.0)
        grid, disc = disc_map.map_grid(geometry.disc, len(inverse.height_mm)), geometry.disc
        rows, cols = np.nonzero(_contact(inverse) & disc_rays(grid, geometry).inside)
        x_px, y_px = (
            grid.col0 + cols * grid.step_px - disc.col_c,
            grid.row0 + rows * grid.step_px - disc.row_c,
        )
        return replace(
            seen,
            located_x_mm=ball.x_mm,
            located_y_mm=ball.y_mm,
            ball_factor=float(_TRIED[best]),
            misfit_ratio=ratio,
            seen_cells=np.stack((x_px, y_px, inverse.height_mm[rows, cols])).astype(np.float64),
        )

    def observe(self, maps: GreyMaps, press: KnownPress) -> PressObservation:
        """The change in the grey maps of a press."""
        return observe_press(self.preprocessor, maps, press)

    def observation(self, look: PressLook, press: KnownPress) -> PressObservation:
        """What the image and the network show of a press."""
        return self.see(look, self.observe(look.maps, press), press)

    def question(self, look: PressLook, ball: KnownPress) -> CalibrationFinding | None:
        """That a ball looks much larger or smaller than stated; None if it does not."""
        seen = self.observation(look, ball)
        larger = seen.ball_factor > _LOOKS[1] and seen.misfit_ratio > _LOOKS_RATIO
        if ball.depth_mm < _LOOKS_DEPTH_MM * skin_scale(self.geometry) or not (
            larger or seen.ball_factor < _LOOKS[0]
        ):
            return None
        return finding(
            FindingCode.LOOKS_LARGER if larger else FindingCode.LOOKS_SMALLER,
            seen_mm=seen.ball_factor * ball.radius_mm,
            stated_mm=ball.radius_mm,
        )

    def judge(self, look: PressLook) -> Judgement:
        """Judge an image."""
        if reason := self._judges.reason(look.grey):
            return Judgement(reason)
        drift = camera_drift.drift(self._reference, look.grey)
        disc, shift = self.geometry.disc, None
        if camera_drift.carries_pattern(drift, disc):
            shift = camera_drift.shift_reason(drift, disc)
        # Before the contact: a picture that moved seems to change everywhere.
        if shift and camera_drift.carried_too_far(drift, disc):
            return Judgement(None, moved=shift)
        changed = shift or drift.light_reason
        in_contact = look.changed_part >= self.gate.plain_part or look.inverse is not None
        return Judgement(None, changed=changed, in_contact=in_contact)


class PressLook:
    """The image of a press, looked at once: what is derived from it is kept, on cells."""

    def __init__(self, check: PressCheck, image: U8) -> None:
        self._check = check
        self._image = image

    @cached_property
    def grey(self) -> U8:
        """The grey image."""
        return self._check.preprocessor.grey(self._image)

    @cached_property
    def _seen(self) -> tuple[float, GreyMaps]:
        check = self._check
        white = check.preprocessor.preprocess(self.grey)
        return check.gate.changed_part(white), check.mapper.maps(white)

    @property
    def changed_part(self) -> float:
        """The part of the picture that changed since the references."""
        return self._seen[0]

    @property
    def maps(self) -> GreyMaps:
        """The grey maps of section IV-A."""
        return self._seen[1]

    @cached_property
    def answer(self) -> Inverse | None:
        """The network's answer; None without a network."""
        solver, seen = self._check.solver, self._check.seen
        return None if solver is None else solver.inverse(seen.preprocess(seen.grey(self._image)))

    @property
    def inverse(self) -> Inverse | None:
        """The network's answer if it sees a contact."""
        answer = self.answer
        seen = answer is not None and np.count_nonzero(_contact(answer)) >= LEAST_CELLS
        return answer if seen else None
