"""Reconstruct one frame, in the order of section IV of the paper."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.contact.detection import TouchDetector
from tacshade_edge.sensor.contact.gate import SURE_PART
from tacshade_edge.sensor.contact.motion import WhiteChange
from tacshade_edge.sensor.contact.objects import Objects, contact_of, find_objects
from tacshade_edge.sensor.contact.rest import Evidence
from tacshade_edge.sensor.contact.tracking import ContactTracker, follow
from tacshade_edge.sensor.depth import SOLVERS, Depth, Network
from tacshade_edge.sensor.depth.learned import LearnedSolver
from tacshade_edge.sensor.depth.sigma import sigma_of_scale_1, terms
from tacshade_edge.sensor.depth.solver import Mark
from tacshade_edge.sensor.frame_check import Measured, first_reason, foreign_skin
from tacshade_edge.sensor.geometry.disc_map import rays_in_image
from tacshade_edge.sensor.look import Eye, Look, UnchangedSkin
from tacshade_edge.sensor.profiles import NETWORK, Profile
from tacshade_edge.sensor.touch.touch_answer import (
    imprint_of,
    quantities_of,
    touch_by_model,
    touch_without_labels,
)
from tacshade_edge.types import (
    F32,
    U8,
    Bool,
    Calibration,
    Frame,
    HeightMap,
    Need,
    ObjectCloud,
    Reconstruction,
    Touch,
    TouchedObject,
    TouchModel,
)

# In order. What a step does not do, it does not mark.
STAGES = ("check", "grey", "gate", "denoise", "depth", "shear", "cloud", "sigma", "touch", "names")

Namer = Callable[[Reconstruction], tuple[TouchedObject, ...]]
"""Gives the objects of a frame in contact the names that were taught."""

FeatureObserver = Callable[[F32], None]
"""Receives the features of each touch, for learning a touch model."""


def no_mark(stage: str) -> None:
    """Ignore a stage's end."""


@dataclass(frozen=True, slots=True, eq=False)
class _Mapped:
    """What the solver makes of a look; no objects without a contact, no features unless asked."""

    depth: Depth
    height_mm: F32
    shear_mm: F32 | None
    objects: Objects | None
    degraded: Reason | None
    features: list[F32] | None


class Reconstructor:
    """Reconstructs frames of one calibrated sensor, deterministically: each is independent, except
    that one with the untouched skin of an earlier frame gets that frame's result, and that what may
    be a contact's dent is no touch for a few seconds. `touch` is the profile's model, the reason
    why it cannot be used, or what observes the features of each requested touch. A model may see
    less change than the gate requires of a contact. `grid` and `rays` are those of every height
    map, `changed_part` is the part of the picture that changed in the latest observed frame;
    `namer` names the objects, if any were taught; `quantities` are those of a touch, or why not.
    """

    def __init__(
        self,
        calibration: Calibration,
        profile: Profile,
        network: Network | None = None,
        touch: TouchModel | Reason | FeatureObserver | None = None,
    ) -> None:
        self.calibration = calibration
        self.profile = profile
        self.namer: Namer | None = None
        self.changed_part = 0.0
        self._eye = eye = Eye(calibration, profile, with_network=network is not None)
        reference = eye.seen.calibration.reference_grey
        self._unchanged = UnchangedSkin(
            reference.shape, eye.seen.calibration.geometry.disc, halved=eye.seen.camera_px > 1
        )
        # Two means find an upper cluster in any map, so the gate decides on a contact.
        judges_contact = network is not None and profile.outline == NETWORK
        self.gate_part = eye.gate.least_part if judges_contact else eye.gate.plain_part
        self._touch = touch
        self._learns = callable(touch)
        self._needs_features = isinstance(touch, TouchModel) or self._learns
        self.quantities = quantities_of(touch, has_shear=network is not None)
        self._touch_part = 0.0 if self._learns else 1.0
        if isinstance(touch, TouchModel):
            self._touch_part = touch.gate_part
        self._solver = SOLVERS[profile.solver](eye.own, network)
        self.grid = self._solver.grid
        self.rays = rays_in_image(self.grid, calibration)
        self._detector: TouchDetector | None = None
        if isinstance(self._solver, LearnedSolver):
            limits = calibration.rest.get(profile.name)
            change = WhiteChange(self._solver.fine_reference, self._solver.fine_inside)
            self._detector = TouchDetector(change, self.rays.inside, limits)
        self._sigma = None if network is None else network.sigma
        zero_mm = np.where(self.rays.inside, np.float32(0), np.float32(np.nan))
        self._zero_mm = zero_mm.astype(np.float32)
        self._zero_shear_mm = np.repeat(self._zero_mm[..., None], 2, axis=2)
        self._nothing = self._without_touch(has_shear=network is not None)

    def _without_touch(self, *, has_shear: bool) -> Reconstruction:
        """The result of the untouched skin."""
        zero_mm = self._zero_mm
        no_points = ObjectCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16))
        return Reconstruction(
            seq=0,
            t_ns=0,
            wall_ns=0,
            profile=self.profile.name,
            valid=True,
            reason=None,
            contact=False,
            saturated=False,
            degraded=None,
            height=self._map(zero_mm, np.zeros(zero_mm.shape, dtype=bool)),
            cloud=no_points,
            shear_mm=self._zero_shear_mm if has_shear else None,
            sigma_mm=None if self._sigma is None else zero_mm + np.float32(np.nan),
        )

    @overload
    def step(self, frame: Frame, mark: Mark = ...) -> Reconstruction: ...

    @overload
    def step(self, frame: Frame, mark: Mark = ..., need: Need = ...) -> Reconstruction | None: ...

    def step(
        self, frame: Frame, mark: Mark = no_mark, need: Need = Need.ALL
    ) -> Reconstruction | None:
        """Reconstruct one frame. `mark` is called with a stage's name (`STAGES`) at its end.

        With the need ``CONTACT``, a frame in contact returns None; without ``SHEAR``, ``SIGMA`` or
        ``TOUCH``, it has no such value.
        """
        look = Look(self._eye, frame.image)
        answer = self._judged(frame, look, mark) or self._gated(frame, look, need, mark)
        if answer is not None:
            return answer
        # So much changed that no network need say whether something touches: who asks only that
        # gets the answer without one.
        if need == Need.CONTACT and look.changes(SURE_PART):
            if self._detector is not None:
                self._detector.contact(frame.t_ns, math.inf)  # nobody asks how deep
            return None
        made = self._mapped(look, need, mark)
        if isinstance(made, Reason):
            return self._empty(frame, reason=made)
        found = self._beside_map(frame, look, made)
        # Marked here, because objects are found in `_mapped` and doubted beside the map.
        mark("cloud")
        if made.objects is None or found:
            return self._without_contact(frame, look, made, found, mark)
        if need == Need.CONTACT:
            return None
        return self._in_contact(frame, made, need, mark)

    def _judged(self, frame: Frame, look: Look, mark: Mark) -> Reconstruction | None:
        """The answer to a frame that a judge refuses, or that shows the same untouched skin as an
        earlier one; None for any other.
        """
        reason = look.size_reason
        # Cheapest first: one comparison recognises most frames of an untouched skin. The judges see
        # grey alone, so a torn frame is refused before anything is binarised.
        unchanged = reason is None and self._unchanged.shown_in(look.grey)
        if reason is None and not unchanged:
            reason = look.grey_reason
        mark("check")
        if unchanged:
            return self._empty(frame, degraded=self._unchanged.degraded)
        if reason is None:
            reason = look.white_reason
            mark("grey")
        return None if reason is None else self._empty(frame, reason=reason)

    def _gated(self, frame: Frame, look: Look, need: Need, mark: Mark) -> Reconstruction | None:
        """The answer to a frame whose picture changed too little for anything to touch."""
        # A touch model was learnt from less change than a contact needs.
        least = self.gate_part
        if Need.TOUCH in need:
            least = min(least, self._touch_part)
        if self._learns:
            self.changed_part = look.changed_part
        changes = look.changes(least)
        mark("gate")
        if changes:
            return None
        if self._is_quiet(look):
            self._unchanged.keep(look.grey, look.degraded)
        return self._empty(frame, degraded=look.degraded)

    def _is_quiet(self, look: Look) -> bool:
        """Whether no request would find more in the frame."""
        return not self._needs_features or look.changed_part < self._touch_part

    def _mapped(self, look: Look, need: Need, mark: Mark) -> _Mapped | Reason:
        """Solve for height, shear and objects; a reason if the picture shows another skin."""
        features: list[F32] | None = None
        if Need.TOUCH in need and self._needs_features:
            features = []
        white, inside = look.own_white, self.rays.inside
        depth = self._solver.solve(white, mark, features)
        reason = first_reason(foreign_skin.map_measured(depth.untrusted_logit, inside))
        degraded = look.degraded or foreign_skin.degraded_reason(depth.untrusted, inside)
        mark("depth")
        if reason:
            return reason
        shear_mm = None
        if Need.SHEAR in need:
            shear_mm = self._solver.shear_mm(white, features)
            if shear_mm is not None:
                shear_mm += self._zero_shear_mm
            mark("shear")
        geometry = self.calibration.geometry
        # The map without contact, 0 or NaN, adds NaN outside the disc.
        # Eq. 2 needs h up to r. Clipped only now: two means split the heights as the solver found
        # them.
        height_mm = np.minimum(depth.height_mm, np.float32(geometry.height_max_mm)) + self._zero_mm
        contact = contact_of(depth, inside, self.profile.outline)
        objects = None
        if look.changes(self.gate_part):
            objects = find_objects(
                contact, height_mm, shear_mm, self.rays, geometry, depth.contact_logit
            )
        return _Mapped(depth, height_mm, shear_mm, objects, degraded, features)

    def _beside_map(self, frame: Frame, look: Look, made: _Mapped) -> Reason | None:
        """Why a frame is another than its map shows: a touch that it does not show, or a contact
        that is the tip's motion. Glare and another light may raise the evidence of a touch.
        """
        solver, detector = self._solver, self._detector
        if detector is None or not isinstance(solver, LearnedSolver):
            return None
        if made.objects is None:
            if made.degraded and made.degraded.code is not ReasonCode.UNTRUSTED:
                return None
            white = solver.fine_white(look.own_white)
            return detector.felt(frame.t_ns, made.depth, white, look.changed_part, look.lift)
        moving = detector.moving(made.depth, lambda: solver.fine_white(look.own_white))
        if moving is None:
            depth_mm = max(each.depth_max_mm for each in made.objects.described)
            detector.contact(frame.t_ns, depth_mm)
        return moving

    def _without_contact(
        self, frame: Frame, look: Look, made: _Mapped, found: Reason | None, mark: Mark
    ) -> Reconstruction:
        """The answer to a frame whose map shows no contact, or one that is none."""
        touched = found is not None and found.code is ReasonCode.TOUCH_UNMEASURED
        answer = self._empty(frame, degraded=found or made.degraded, touched=touched)
        if made.features:  # a model of labels may know a touch that the map does not show
            return self._with_touch(answer, made.features, mark)
        relaxed = self._detector is None or self._detector.relaxed(frame.t_ns)
        if self._is_quiet(look) and not found and relaxed:
            self._unchanged.keep(look.grey, made.degraded)
        return answer

    def _in_contact(self, frame: Frame, made: _Mapped, need: Need, mark: Mark) -> Reconstruction:
        depth, objects = made.depth, made.objects
        assert objects is not None
        sigma_mm = None
        if Need.SIGMA in need:
            sigma_mm = self._sigma_mm(depth, made.height_mm, objects.contact)
            mark("sigma")
        untrusted = None
        if depth.untrusted is not None and depth.untrusted.any():
            untrusted = depth.untrusted & self.rays.inside
        whole = self._empty(
            frame,
            degraded=made.degraded,
            contact=True,
            saturated=depth.saturated,
            height=self._map(made.height_mm, objects.contact),
            cloud=objects.cloud,
            objects=objects.described,
            volume_mm3=objects.volume_mm3,
            repaired_px=depth.repaired_px,
            shear_mm=made.shear_mm,
            sigma_mm=sigma_mm,
            untrusted=untrusted,
        )
        if Need.TOUCH in need:
            whole = self._with_touch(whole, made.features, mark)
        if self.namer is not None:
            whole = replace(whole, objects=self.namer(whole))
            mark("names")
        return whole

    def measured(self, image: U8) -> tuple[Measured, ...]:
        """What the judges measure of an image that has the calibrated size;
        nothing after the first that refuses.
        """
        return self._measured(Look(self._eye, image))

    def _measured(self, look: Look) -> tuple[Measured, ...]:
        made = look.measured
        if first_reason(made) is None and look.changes(self.gate_part):
            depth = self._solver.solve(look.own_white, no_mark)
            made += foreign_skin.map_measured(depth.untrusted_logit, self.rays.inside)
        return made

    def depth(self, image: U8) -> Depth:
        """The solver's depth for an image, without frame check and gate."""
        return self._solver.solve(Look(self._eye, image).own_white, no_mark)

    def evidence(self, image: U8) -> Evidence | Reason:
        """What speaks for a touch in an image, or why the image is invalid or degraded; the gate is
        not asked, and the profile must have a network.
        """
        look = Look(self._eye, image)
        if reason := look.size_reason or first_reason(self._measured(look)) or look.degraded:
            return reason
        assert isinstance(self._solver, LearnedSolver)
        assert self._detector is not None
        depth = self._solver.solve(look.own_white, no_mark)
        white = self._solver.fine_white(look.own_white)
        return self._detector.evidence(depth, white, look.changed_part)

    def _with_touch(
        self, made: Reconstruction, features: list[F32] | None, mark: Mark
    ) -> Reconstruction:
        touch: Touch | None = None
        if isinstance(self._touch, Reason):
            touch = Touch(reason=self._touch)
        elif isinstance(self._touch, TouchModel) and features:
            imprint = imprint_of(made.objects, made.volume_mm3) if made.contact else None
            touch = touch_by_model(self._touch, np.concatenate(features), imprint)
        else:
            if made.contact:
                touch = touch_without_labels(made.objects, made.shear_of_contact_mm)
            if callable(self._touch) and features:
                self._touch(np.concatenate(features))
        mark("touch")
        return replace(made, touch=touch)

    def _sigma_mm(self, depth: Depth, height_mm: F32, contact: Bool) -> F32 | None:
        if self._sigma is None or depth.contact_logit is None or depth.untrusted_logit is None:
            return None
        calibration = self.calibration
        x = terms(
            height_mm, depth.contact_logit, depth.untrusted_logit, contact, calibration.geometry
        )
        scale = calibration.error_scale(self.profile.name) or self._sigma.scale_without_presses
        made: F32 = np.full(contact.shape, np.nan, np.float32)
        sigma_mm = sigma_of_scale_1(self._sigma, x, calibration.geometry) * np.float32(scale)
        made.put(np.flatnonzero(contact), sigma_mm)
        return made

    def _empty(self, frame: Frame, **found: Any) -> Reconstruction:
        """The reconstruction without contact or of an invalid frame, exactly 0 inside the disc,
        but for `found`.
        """
        valid = found.get("reason") is None
        return replace(
            self._nothing,
            seq=frame.seq,
            t_ns=frame.t_ns,
            wall_ns=frame.wall_ns,
            valid=valid,
            **found,
        )

    def _map(self, height_mm: F32, contact: Bool) -> HeightMap:
        return HeightMap(height_mm, contact, self.grid.row0, self.grid.col0, self.grid.step_px)


def step_and_track(
    reconstructor: Reconstructor,
    tracker: ContactTracker | None,
    frame: Frame,
    mark: Mark = no_mark,
    need: Need = Need.ALL,
) -> Reconstruction | None:
    """Reconstruct a frame with `Reconstructor.step`,
    and track its objects unless `tracker` is None.
    """
    made = reconstructor.step(frame, mark, need)
    return made if tracker is None or made is None or not made.valid else follow(tracker, made)
