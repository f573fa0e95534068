"""Reconstruct one frame, in the order of section IV of the paper."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, overload

import numpy as np

from tacshade_edge.core.contact.detection import TouchDetector
from tacshade_edge.core.contact.gate import (
    SURE_PART,
    ContactGate,
    UnchangedSkin,
    gate_preprocessor,
)
from tacshade_edge.core.contact.motion import WhiteChange
from tacshade_edge.core.contact.objects import Objects, contact_of, find_objects
from tacshade_edge.core.contact.rest import Evidence
from tacshade_edge.core.contact.tracking import ContactTracker, follow
from tacshade_edge.core.depth import SOLVERS, Depth, Network
from tacshade_edge.core.depth.base import Mark
from tacshade_edge.core.depth.learned import LearnedSolver
from tacshade_edge.core.depth.sigma import sigma_of_scale_1, terms
from tacshade_edge.core.frame_check import (
    Judges,
    Measured,
    first_reason,
    picture,
    size_reason,
    skin,
)
from tacshade_edge.core.geometry.disc_map import rays_in_image
from tacshade_edge.core.image.preprocess import Preprocessed, Preprocessor
from tacshade_edge.core.profiles import NETWORK, Profile
from tacshade_edge.core.touch.answer import imprint_of, touch_by_model, touch_without_labels
from tacshade_edge.reasons import Reason, ReasonCode
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

STAGES = (
    "check",
    "grey",
    "gate",
    "denoise",
    "depth",
    "shear",
    "cloud",
    "sigma",
    "touch",
    "names",
)  # in order

Namer = Callable[[Reconstruction], tuple[TouchedObject, ...]]
"""Gives the objects of a frame in contact the names that were taught."""


def no_mark(stage: str) -> None:
    """Ignore a stage's end."""


class Reconstructor:
    """Reconstructs frames of one calibrated sensor, deterministically: each is independent, except
    that one with the untouched skin of an earlier frame gets that frame's result, and that what may
    be a contact's dent is no touch for a few seconds. `touch` is the profile's model, or the reason
    why it cannot be used; a list collects the features of each requested touch for learning. A
    model may see less change than the gate requires of a contact. `grid` and `rays` are those of
    every height map, `changed_part` is the part of the picture that changed in the latest frame;
    `namer` names the objects, if any were taught.
    """

    def __init__(
        self,
        calibration: Calibration,
        profile: Profile,
        network: Network | None = None,
        touch: TouchModel | Reason | list[F32] | None = None,
    ) -> None:
        self.calibration = calibration
        self.profile = profile
        self._shape = (calibration.image_height_px, calibration.image_width_px)
        self._preprocessor = Preprocessor(calibration, profile)
        # The judges and the gate see the same pictures in every profile.
        self._seen = seen = gate_preprocessor(calibration, self._preprocessor)
        disc, grey = seen.calibration.geometry.disc, seen.calibration.reference_grey
        self._judges = Judges(
            grey, disc, None if network else seen.calibration.pitch_px, seen.camera_px
        )
        self._unchanged = UnchangedSkin(grey.shape, disc, halved=seen.camera_px == 2)
        self._gate = ContactGate(seen)
        # Two means find an upper cluster in any map,
        # so the gate decides whether there is a contact.
        judges_contact = network is not None and profile.outline == NETWORK
        self.gate_part = self._gate.least_part if judges_contact else self._gate.plain_part
        self._solver = SOLVERS[profile.solver](self._preprocessor, network)
        self._touch = touch
        self._touch_part = (
            touch.gate_part
            if isinstance(touch, TouchModel)
            else 0.0
            if isinstance(touch, list)
            else 1.0
        )
        self.namer: Namer | None = None
        self.changed_part = 0.0
        self.grid = self._solver.grid
        self.rays = rays_in_image(self.grid, calibration)
        self._zero_mm = np.where(self.rays.inside, np.float32(0), np.float32(np.nan)).astype(
            np.float32
        )
        self._zero_shear_mm = np.repeat(self._zero_mm[..., None], 2, axis=2)
        self._detector: TouchDetector | None = None
        if isinstance(self._solver, LearnedSolver):
            limits = calibration.rest.get(profile.name)
            change = WhiteChange(self._solver.fine_reference, self._solver.fine_inside)
            self._detector = TouchDetector(change, self.rays.inside, limits)
        self._sigma = None if network is None else network.sigma
        self._nothing = Reconstruction(
            seq=0,
            t_ns=0,
            wall_ns=0,
            profile=profile.name,
            valid=True,
            reason=None,
            contact=False,
            saturated=False,
            degraded=None,
            height=self._map(self._zero_mm, np.zeros(self._zero_mm.shape, dtype=bool)),
            cloud=ObjectCloud(np.zeros((0, 3), dtype=np.float32), np.zeros(0, dtype=np.uint16)),
            shear_mm=self._zero_shear_mm if network is not None else None,
            sigma_mm=None
            if self._sigma is None
            else np.full(self._zero_mm.shape, np.nan, np.float32),
        )
        self._grey_space: U8 = np.empty(self._shape, np.uint8)
        self._white_space = seen.integrator.space()
        shared = seen is self._preprocessor
        self._own_white_space = (
            self._white_space if shared else self._preprocessor.integrator.space()
        )

    @overload
    def step(self, frame: Frame, mark: Mark = ...) -> Reconstruction: ...

    @overload
    def step(self, frame: Frame, mark: Mark = ..., need: Need = ...) -> Reconstruction | None: ...

    def step(
        self, frame: Frame, mark: Mark = no_mark, need: Need = Need.ALL
    ) -> Reconstruction | None:
        """Reconstruct one frame; `mark` is called with a stage's name (`STAGES`) at its end.

        With the need ``CONTACT``, a frame in contact returns None; without ``SHEAR``, ``SIGMA`` or
        ``TOUCH``, it has no such value.
        """
        grey = self._seen.grey(frame.image, self._grey_space)
        reason = size_reason(frame.image, self._shape)
        unchanged = reason is None and self._unchanged.shown_in(grey)
        reason = reason or (None if unchanged else first_reason(self._judges.measured(grey)))
        mark("check")
        if reason or unchanged:
            return self._empty(
                frame, reason=reason, degraded=self._unchanged.degraded if unchanged else None
            )

        preprocessed = self._seen.preprocess(grey, self._white_space)
        drift_grey = self._seen.drift_grey(self._seen.ratio(preprocessed.white))
        reason = first_reason(picture.white_measured(preprocessed.unseen, drift_grey))
        degraded = picture.degraded_reason(preprocessed.unseen, drift_grey)
        mark("grey")
        if reason:
            return self._empty(frame, reason=reason)

        self.changed_part = changed_part = self._gate.changed_part(preprocessed)
        mark("gate")
        # `quiet`: no request would find more in this frame.
        quiet = not isinstance(self._touch, TouchModel | list) or changed_part < self._touch_part
        if changed_part < (
            min(self._touch_part, self.gate_part) if Need.TOUCH in need else self.gate_part
        ):
            if quiet:
                self._unchanged.keep(grey, degraded)
            return self._empty(frame, degraded=degraded)

        if need == Need.CONTACT and changed_part >= SURE_PART:
            if self._detector is not None:
                self._detector.contact(frame.t_ns, math.inf)  # nobody asks how deep
            return None

        features: list[F32] | None = (
            [] if Need.TOUCH in need and isinstance(self._touch, TouchModel | list) else None
        )
        if self._preprocessor is not self._seen:
            own = self._preprocessor.grey(frame.image, self._grey_space)
            preprocessed = self._preprocessor.preprocess(own, self._own_white_space)
        depth = self._solver.solve(preprocessed, mark, features)
        reason = first_reason(skin.map_measured(depth.untrusted_logit, self.rays.inside))
        degraded = degraded or skin.degraded_reason(depth.untrusted, self.rays.inside)
        mark("depth")
        if reason:
            return self._empty(frame, reason=reason)

        shear_mm = None
        if Need.SHEAR in need:
            shear_mm = self._solver.shear_mm(preprocessed, features)
            if shear_mm is not None:
                shear_mm += self._zero_shear_mm
            mark("shear")

        # The map without contact, 0 or NaN, adds NaN outside the disc.
        height_mm = (
            np.minimum(depth.height_mm, np.float32(self.calibration.geometry.height_max_mm))
            + self._zero_mm
        )
        contact = contact_of(depth, self.rays.inside, self.profile.outline)
        objects = None
        if changed_part >= self.gate_part:
            objects = find_objects(
                contact,
                height_mm,
                shear_mm,
                self.rays,
                self.calibration.geometry,
                depth.contact_logit,
            )
        found = self._beside_map(frame, preprocessed, depth, objects, degraded)
        mark("cloud")
        if objects is None or found:
            touched = found is not None and found.code is ReasonCode.TOUCH_UNMEASURED
            made = self._empty(frame, degraded=found or degraded, touched=touched)
            if features:  # a model of labels may know a touch that the map does not show
                return self._with_touch(made, features, mark)
            relaxed = self._detector is None or self._detector.relaxed(frame.t_ns)
            if quiet and not found and relaxed:
                self._unchanged.keep(self._seen.grey(frame.image, self._grey_space), degraded)
            return made
        if need == Need.CONTACT:
            return None
        sigma_mm = None
        if Need.SIGMA in need:
            sigma_mm = self._sigma_mm(depth, height_mm, objects.contact)
            mark("sigma")
        untrusted = (
            depth.untrusted if depth.untrusted is not None and depth.untrusted.any() else None
        )
        whole = self._empty(
            frame,
            degraded=degraded,
            contact=True,
            saturated=depth.saturated,
            height=self._map(height_mm, objects.contact),
            cloud=objects.cloud,
            objects=objects.described,
            volume_mm3=objects.volume_mm3,
            repaired_px=depth.repaired_px,
            shear_mm=shear_mm,
            sigma_mm=sigma_mm,
            untrusted=None if untrusted is None else untrusted & self.rays.inside,
        )
        if Need.TOUCH in need:
            whole = self._with_touch(whole, features, mark)
        if self.namer is not None:
            whole = replace(whole, objects=self.namer(whole))
            mark("names")
        return whole

    def measured(self, image: U8) -> tuple[Measured, ...]:
        """What the judges measure of an image that has the calibrated size;
        nothing after the first that refuses.
        """
        grey = self._seen.grey(image)
        made = self._judges.measured(grey)
        if first_reason(made) is None:
            preprocessed = self._seen.preprocess(grey)
            drift_grey = self._seen.drift_grey(self._seen.ratio(preprocessed.white))
            made += picture.white_measured(preprocessed.unseen, drift_grey)
            if (
                first_reason(made) is None
                and self._gate.changed_part(preprocessed) >= self.gate_part
            ):
                made += skin.map_measured(self.depth(image).untrusted_logit, self.rays.inside)
        return made

    def depth(self, image: U8) -> Depth:
        """The solver's depth for an image, without frame check and gate."""
        return self._solver.solve(
            self._preprocessor.preprocess(self._preprocessor.grey(image)), no_mark
        )

    def evidence(self, image: U8) -> Evidence | Reason:
        """What speaks for a touch in an image, or why the image is invalid or degraded; the gate is
        not asked, and the profile must have a network.
        """
        if reason := size_reason(image, self._shape) or first_reason(self.measured(image)):
            return reason
        seen = self._seen.preprocess(self._seen.grey(image))
        drift_grey = self._seen.drift_grey(self._seen.ratio(seen.white))
        degraded = picture.degraded_reason(seen.unseen, drift_grey)
        changed_part = self._gate.changed_part(seen)
        own = self._preprocessor.preprocess(self._preprocessor.grey(image))
        assert isinstance(self._solver, LearnedSolver)
        assert self._detector is not None
        depth, white = self._solver.solve(own, no_mark), self._solver.fine_white(own)
        return degraded or self._detector.evidence(depth, white, changed_part)

    def _beside_map(
        self,
        frame: Frame,
        preprocessed: Preprocessed,
        depth: Depth,
        objects: Objects | None,
        degraded: Reason | None,
    ) -> Reason | None:
        """Why a frame is another than its map shows: a touch that it does not show, or a contact
        that is the tip's motion. Glare and another light may raise the evidence of a touch.
        """
        solver, detector = self._solver, self._detector
        if detector is None or not isinstance(solver, LearnedSolver):
            return None
        white = solver.fine_white(preprocessed)
        if objects is None:
            if degraded and degraded.code is not ReasonCode.UNTRUSTED:
                return None
            lift = partial(self._seen.lift, frame.image)
            return detector.felt(frame.t_ns, depth, white, self.changed_part, lift)
        moving = detector.moving(depth, white)
        if moving is None:
            detector.contact(frame.t_ns, max(each.depth_max_mm for each in objects.described))
        return moving

    def _with_touch(
        self, made: Reconstruction, features: list[F32] | None, mark: Mark
    ) -> Reconstruction:
        touch: Touch | None
        if isinstance(self._touch, Reason):
            touch = Touch(reason=self._touch)
        elif isinstance(self._touch, TouchModel) and features:
            imprint = imprint_of(made.objects, made.volume_mm3) if made.contact else None
            touch = touch_by_model(self._touch, np.concatenate(features), imprint)
        else:
            touch = (
                touch_without_labels(made.objects, made.shear_of_contact_mm)
                if made.contact
                else None
            )
            if isinstance(self._touch, list) and features:
                self._touch.append(np.concatenate(features))
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
