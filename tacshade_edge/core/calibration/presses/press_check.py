"""Check one press: does a learned profile, without a refit, see a contact, where, and how large is the ball; and, while
the indenter is still there, can `calibrate` use the image?
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.core.calibration.indenters import ball_along, ball_height_along, known_height
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.observation import PressObservation
from tacshade_edge.core.calibration.quality import GRADED_PROFILE
from tacshade_edge.core.calibration.reference.references import PROFILE
from tacshade_edge.core.calibration.refit import LEAST_CELLS, contact_direction, placed_press
from tacshade_edge.core.contact.gate import ContactGate
from tacshade_edge.core.depth import Network
from tacshade_edge.core.depth.learned import Inverse, LearnedSolver
from tacshade_edge.core.frame_check import camera, plain_judges
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.disc import disc_rays, skin_points
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import PROFILES, Profile
from tacshade_edge.reasons import Reason
from tacshade_edge.types import F32, F64, U8, Bool, Calibration, Geometry

# Radii to try, as multiples of the stated one, which is in the middle; and the floor for a misfit.
_LEAST_MISFIT = 1e-3
_TRIED = np.exp(np.linspace(math.log(0.25), math.log(4.0), 49))


@dataclass(frozen=True, slots=True)
class PressView:
    """A press as a network sees it: the greatest height in the contact, and the place of the indenter, given its stated
    radius and depth. `ball_factor` is the radius, as a multiple of the stated one, that fits the heights best, at any
    factor on them (NaN for another indenter); `misfit_ratio` the misfit of the stated radius over that of the best.
    """

    depth_mm: float
    x_mm: float
    y_mm: float
    ball_factor: float
    misfit_ratio: float = 1.0


class PressViewer:
    """Measures presses of one sensor with the network of a profile, from its calibration without presses."""

    def __init__(self, unloaded: Calibration, profile: Profile, network: Network) -> None:
        self._geometry = unloaded.geometry
        self._preprocessor = Preprocessor(unloaded, profile)
        self._solver = LearnedSolver(self._preprocessor, network)

    def view(self, press: KnownPress) -> PressView | None:
        """The view of a press; None if the network sees no contact."""
        return view_of(self._inverse(press.image), self._geometry, press)

    def touches(self, image: U8) -> bool:
        """Whether the network sees a contact in an image."""
        return bool(np.count_nonzero(_contact(self._inverse(image))) >= LEAST_CELLS)

    def _inverse(self, image: U8) -> Inverse:
        return self._solver.inverse(self._preprocessor.preprocess(self._preprocessor.grey(image)))


def view_of(inverse: Inverse, geometry: Geometry, press: KnownPress) -> PressView | None:
    """The view of a press from a network's answer; None if it sees no contact."""
    contact = _contact(inverse)
    if np.count_nonzero(contact) < LEAST_CELLS:
        return None
    depth_mm = float(inverse.height_mm[contact].max())
    if press.indenter is not None:
        x_mm, y_mm = _indenter_place(inverse, geometry, press)
        return PressView(depth_mm, x_mm, y_mm, math.nan)
    along = contact_direction(geometry, inverse)
    if along is None:
        return None
    ball = ball_along(geometry, along, press.depth_mm, press.radius_mm)
    misfits = _misfits(inverse, geometry, along, press)
    best, stated = int(np.argmin(misfits)), misfits[len(_TRIED) // 2]
    ratio = stated / max(misfits[best], _LEAST_MISFIT)
    return PressView(depth_mm, ball.x_mm, ball.y_mm, float(_TRIED[best]), max(ratio, 1.0))


def as_seen(observation: PressObservation, view: PressView | None) -> PressObservation:
    """The observation with the place that the network saw, if it saw a contact."""
    if view is None:
        return observation
    return replace(
        observation,
        located_x_mm=view.x_mm,
        located_y_mm=view.y_mm,
        reach_mm=0.0,
        ball_factor=view.ball_factor,
        misfit_ratio=view.misfit_ratio,
        is_seen=True,
    )


def _contact(inverse: Inverse) -> Bool:
    return np.asarray((inverse.contact_logit > 0) & np.isfinite(inverse.height_mm))


def _indenter_place(inverse: Inverse, geometry: Geometry, press: KnownPress) -> tuple[float, float]:
    """The stated place, shifted by the difference between the centroids of the heights and the indenter's surface."""
    placed = placed_press(geometry, inverse, press)
    found = np.where(_contact(inverse), inverse.height_mm, np.float32(0))
    middle = _middle(found, geometry)
    if placed is None or press.x_mm is None or press.y_mm is None:
        return float(middle[0]), float(middle[1])
    under: F32 = np.maximum(np.nan_to_num(known_height(geometry, placed, len(found))), np.float32(0))
    if np.count_nonzero(under) < LEAST_CELLS:
        return float(middle[0]), float(middle[1])
    beside = middle - _middle(under, geometry)
    return press.x_mm + float(beside[0]), press.y_mm + float(beside[1])


def _middle(height_mm: F32, geometry: Geometry) -> F64:
    """Mean x and y of the skin where its height is above 0, weighted by the height; mm."""
    height = np.maximum(height_mm, np.float32(0))
    rays = disc_rays(disc_map.map_grid(geometry.disc, len(height)), geometry)
    use = (height > 0) & rays.inside
    points = skin_points(height, rays, geometry)[use].astype(np.float64)
    return np.asarray(np.average(points[:, :2], axis=0, weights=height[use])) if use.any() else np.zeros(2)


def _misfits(inverse: Inverse, geometry: Geometry, along: F64, press: KnownPress) -> list[float]:
    """For each radius tried, the part of the squared heights in the contact that its surface does not explain."""
    rays = disc_rays(disc_map.map_grid(geometry.disc, len(inverse.height_mm)), geometry)
    use = _contact(inverse)
    found, inside = inverse.height_mm[use].astype(np.float64), rays.inside[use]
    u, v = rays.u[use].astype(np.float64), rays.v[use].astype(np.float64)
    misfits = []
    for part in _TRIED:
        ball = ball_along(geometry, along, press.depth_mm, part * press.radius_mm)
        height = ball_height_along(geometry, ball, u, v)
        known = np.where(inside & (height > 0), height, 0).astype(np.float32).astype(np.float64)
        likeness = float(found @ known) ** 2 / max(float(found @ found) * float(known @ known), np.finfo(float).tiny)
        misfits.append(1 - likeness)
    return misfits


@dataclass(frozen=True, slots=True)
class Judgement:
    """The judgement on an image of a press; an unusable one leaves the other fields without meaning. `moved` says that
    the camera moved too far since the references, `changed` what changed less; both empty if nothing did.
    """

    unusable: Reason | None
    moved: str = ""
    changed: str = ""
    in_contact: bool = False


class PressCheck:
    """Judges images of one sensor from its calibration without presses; a network of `GRADED_PROFILE` also sees light
    contacts.
    """

    def __init__(self, unloaded: Calibration, network: Network | None = None) -> None:
        self.geometry = unloaded.geometry
        self._preprocessor = Preprocessor(unloaded, PROFILE)
        self._gate = ContactGate(self._preprocessor)
        self._judges = plain_judges(unloaded)
        self._viewer = PressViewer(unloaded, PROFILES[GRADED_PROFILE], network) if network else None
        self._disc = unloaded.geometry.disc
        self._reference = camera.look(unloaded.reference_grey, self._disc, unloaded.pitch_px)

    def judge(self, image: U8) -> Judgement:
        """Judge an image (H, W) or (H, W, 3)."""
        grey = self._preprocessor.grey(image)
        if reason := self._judges.reason(grey):
            return Judgement(reason)
        drift = camera.drift(self._reference, grey)
        shift = camera.shift_reason(drift, self._disc)
        if shift and camera.shifted_too_far(drift, self._disc):
            return Judgement(None, moved=str(shift))
        changed = str(shift or drift.light_reason or "")
        in_contact = self._gate.changed_part(self._preprocessor.preprocess(grey)) >= self._gate.plain_part
        if not in_contact and self._viewer:
            in_contact = self._viewer.touches(grey)
        return Judgement(None, changed=changed, in_contact=in_contact)
