"""The reference in use: taken on request, or followed from frames of the resting sensor, which also
show where a touch begins.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from tacshade_edge.calibration.files import ageing_file, reference_file
from tacshade_edge.calibration.files.calibration_file import with_crc
from tacshade_edge.calibration.files.objects_file import Known
from tacshade_edge.calibration.files.reference_file import LearntLimits, StoredReference, limited
from tacshade_edge.calibration.reference import references
from tacshade_edge.calibration.reference.references import Distance
from tacshade_edge.daemon.ageing_watch import AgeingWatch
from tacshade_edge.daemon.reference_origin import Origin, requested, restored
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files.atomic_files import FolderLock
from tacshade_edge.free_memory import return_free_memory
from tacshade_edge.pipeline.observer import (
    STITCHED_S,
    STOPPING,
    FrameObserver,
    FrameResult,
    Reply,
)
from tacshade_edge.reasons import Reason, ReasonCode, code_of, reason_fields
from tacshade_edge.sensor.contact.untouched import (
    Measured,
    RestLearner,
    Untouched,
    UntouchedFrames,
    worth,
)
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Calibration, Need
from tacshade_edge.wire.results import ReferenceTaken

_log = logging.getLogger(__name__)

REFERENCE_FRAMES = 10
REFERENCE_TIMEOUT_S = 5.0
NO_RECONSTRUCTOR = Reason(ReasonCode.STARTING, "starting")
State = Literal["waiting", "following", "stopped", "held"]


class References(FrameObserver):
    """Where the reference began, and how far it has followed from there; handles ``req/reference``.

    `use` receives each new one; `changed` is called when only its state is new; while a recording
    `held` it, it does not follow. What the `running` reconstructor finds in untouched frames sets
    the limits of its profile. Once a day, `AgeingWatch` compares some with the calibration's
    reference.
    """

    health_key = "reference"
    stop_s = STITCHED_S

    def __init__(
        self,
        calibrated: Calibration | Reason,
        path: Path,
        sensor_id: str,
        use: Callable[[Calibration], None],
        changed: Callable[[], None] = lambda: None,
        held: Callable[[], bool] = lambda: False,
        running: Callable[[], Reconstructor | Reason] = lambda: NO_RECONSTRUCTOR,
    ) -> None:
        self._sensor_id = sensor_id
        self._path = path
        self._use, self._changed, self._held, self._running = use, changed, held, running
        self._lock: FolderLock | None = None
        self._unowned: Reason | None = None
        self.frames = UntouchedFrames(self._measure)
        self._learners: dict[str, RestLearner] = {}
        # Waits until nothing has touched for a while: the beginning of a slow touch looks
        # untouched.
        self._batch: Untouched | None = None
        self._request: tuple[Reply, float] | None = None  # and its deadline
        self._images: list[U8] | None = None  # what it collects, in the reconstruct thread
        self._collected: list[U8] | Reason | None = None
        self._looks = self._renewals = 0
        self._state: State = "waiting"
        self._reason: Reason | None = None
        self._distance: Distance | None = None
        self._origin: Origin | Reason
        self._ageing: AgeingWatch | None = None
        self.calibration: Calibration | Reason
        self.reload(calibrated, path)

    def reload(self, calibrated: Calibration | Reason, path: Path) -> None:
        if path != self._path:
            self._release_file()
            self._path = path
        if isinstance(calibrated, Reason):
            self._origin = self.calibration = calibrated
            self._ageing = None
        else:
            self._own_file()
            history = ageing_file.path_beside_reference(path)
            self._ageing = AgeingWatch(calibrated, history)
            self._begin(restored(calibrated, path, self._unowned))

    def know(self, known: Known) -> None:
        """Use other taught objects, with the same reference."""
        if isinstance(self._origin, Reason) or isinstance(self.calibration, Reason):
            return
        calibrated, first = self._origin.calibrated, self._origin.calibration
        self._origin = replace(
            self._origin,
            calibrated=replace(calibrated, known=known),
            calibration=replace(first, known=known),
        )
        self.calibration = taught = replace(self.calibration, known=known)
        self._use(taught)

    def handle(self, reply: Reply) -> None:
        """Take a reference from the next frames."""
        if self._request is not None:
            reply(Reason(ReasonCode.BUSY, "busy: already taking a reference"))
            return
        self._request = reply, time.monotonic() + REFERENCE_TIMEOUT_S
        # In this order: the reconstruct thread collects as soon as there is a list.
        self._collected = None
        self._images = []

    def need(self) -> Need:
        return Need.CONTACT if self._images is None else Need.DEPTH

    def see(self, seen: FrameResult) -> None:
        self.frames.see(seen.frame, seen.reconstruction)
        images, result = self._images, seen.reconstruction
        if images is None or result is None or self._collected is not None:
            return
        what = f"frame {seen.frame.seq}: found"
        if not result.valid:
            text = (
                f"{what} an invalid frame ({result.reason}), expected a valid frame of an "
                "untouched sensor"
            )
            self._collected = Reason(ReasonCode.FRAME_INVALID, text)
        elif result.contact or result.touched:
            depth = "of unknown depth" if result.touched else f"{result.depth_max_mm:.2f} mm deep"
            text = f"{what} a contact {depth}, expected no contact"
            self._collected = Reason(ReasonCode.FRAME_IN_CONTACT, text)
        else:
            images.append(seen.frame.image)
            if len(images) == REFERENCE_FRAMES:
                self._collected = images

    def poll(self) -> None:
        if self._request is not None:
            (reply, deadline_s), images = self._request, self._collected
            if images is None and time.monotonic() >= deadline_s:
                text = (
                    f"received fewer than {REFERENCE_FRAMES} frames within "
                    f"{REFERENCE_TIMEOUT_S:.0f} s"
                )
                images = Reason(ReasonCode.TIMEOUT, text)
            if images is not None:
                self._request = self._images = None
                reply(images if isinstance(images, Reason) else self._taken(images))
        if (frames := self.frames.take()) is not None:
            self.follow(frames)
        if (batch := self._batch) is not None:
            untouched = self.frames.untouched_since(batch.end_ns)
            if untouched is not None:
                self._batch = None
            if untouched:
                self._learn(batch)

    def stop(self, timeout_s: float = 0) -> None:
        """Refuse a request that waits for frames, and let another daemon have the stored
        reference.
        """
        if self._request is not None:
            reply, self._request = self._request[0], None
            reply(STOPPING)
        self._release_file()

    def _release_file(self) -> None:
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def _own_file(self) -> None:
        """Become the one daemon that stores references here, or note why not."""
        if self._lock is not None:
            return
        self._unowned = None
        try:
            self._lock = FolderLock(
                self._path.parent, f"sensor {self._sensor_id}", file=self._path.name
            )
        except DeviceError as error:
            # A folder that cannot be written is reported when something is stored.
            if error.code is ReasonCode.IN_USE:
                _log.warning("%s; this daemon does not store new references", error)
                self._unowned = error.reason

    def _taken(self, images: Sequence[U8]) -> ReferenceTaken | Reason:
        """Start over with images of the resting sensor, or return why they cannot be used."""
        if isinstance(self._origin, Reason):
            return self._origin
        self._own_file()
        try:
            known = self._origin
            origin = requested(
                known.calibrated, images, self._path, self._unowned, limits=known.limits
            )
        except ConfigError as error:
            return Reason(ReasonCode.REFERENCE_INVALID, str(error))
        self._begin(origin)
        taken = origin.calibration
        self._use(taken)
        return ReferenceTaken(len(images), taken.crc32, taken.noise_grey, unstored=origin.reason)

    def _measure(self, image: U8) -> Measured | None:
        """What the running profile finds; called in the reconstruct thread, which runs it."""
        running = self._running()
        if isinstance(running, Reason) or running.profile.network is None:
            return None
        found = running.evidence(image)
        return None if isinstance(found, Reason) else (running.profile.name, found)

    def follow(self, frames: Untouched | Reason) -> None:
        """Follow frames of the sensor at rest, unless there was a doubt about one of them,
        or a recording goes on.
        """
        if isinstance(self._origin, Reason) or isinstance(self.calibration, Reason):
            return
        if self._held():
            # A recording holds one calibration: its replay with another would not be what was
            # published.
            self._change_state("held", None)
            return
        self._looks += 1
        if isinstance(frames, Reason):
            self._change_state("stopped", frames)
            return
        if self._ageing is not None:
            self._ageing.see(frames.images, owned=self._unowned is None)
        followed = references.follow(self._origin.calibration, self.calibration, frames.images)
        # Judging ten images leaves 7 MB of heap, and a sensor at rest looks once a minute.
        return_free_memory()
        self._distance = followed.distance
        self._change_state("stopped" if followed.reason else "following", followed.reason)
        if followed.reason is None and frames.evidence:
            self._batch = replace(frames, images=[])
        # A new reference during a contact would be a step in its heights;
        # the next frames at rest yield it again.
        if followed.calibration is not None and self.frames.at_rest:
            self.calibration = with_crc(followed.calibration)
            self._renewals += 1
            # Not at a higher level: while a skin warms up, this happens every minute.
            _log.debug("reference renewed: %s", followed.distance)
            self._use(self.calibration)

    def _learn(self, batch: Untouched) -> None:
        """Learn from a batch where touches begin, and use that if it is worth it; like a new
        reference, not during a contact or a recording.
        """
        origin, current = self._origin, self.calibration
        if isinstance(origin, Reason) or isinstance(current, Reason):
            return
        profile = batch.profile
        learner = self._learners.setdefault(profile, RestLearner())
        learner.add(batch)
        # The first limits bound all later ones, so that slow, light touches never widen them
        # away.
        first = origin.calibrated.rest.get(profile)
        if first is None and profile in origin.limits:
            first = origin.limits[profile].first
        present, made = current.rest.get(profile), learner.limits(first)
        if made is None or not worth(present, made) or not self.frames.at_rest or self._held():
            return
        limits = {**origin.limits, profile: LearntLimits(made, first or made)}
        before = f" ({present.height_mm:.2g} mm before)" if present else ""
        text = (
            "%s now reports a touch from %.2g mm of its own heights on%s, "
            "as %d untouched frames show"
        )
        _log.info(text, profile, made.height_mm, before, made.frames)
        self._origin = replace(
            origin, calibration=limited(origin.calibration, limits), limits=limits
        )
        self.calibration = limited(current, limits)
        self._use(self.calibration)
        self._store_limits(self._origin)

    def _store_limits(self, origin: Origin) -> None:
        self._own_file()
        if self._unowned is not None:
            return
        wall_ns = time.time_ns() if origin.wall_ns is None else origin.wall_ns
        stored = StoredReference(origin.calibration, wall_ns, origin.source, origin.limits)
        try:
            reference_file.save(self._path, origin.calibrated, stored)
        except DeviceError as error:
            _log.warning("%s; where touches begin is known until the next start or reload", error)

    def info(self) -> dict[str, Any] | None:
        """The content for ``info``."""
        if isinstance(self._origin, Reason):
            return None
        disc = self._origin.calibration.geometry.disc
        state = {"state": self._state, **reason_fields(self._reason, "stopped")}
        return {**self._origin.as_dict(), "bounds": references.bounds(disc), **state}

    def health(self) -> dict[str, Any]:
        """How it follows, and how far the latest frames at rest were from where it began."""
        return {
            "state": self._state,
            **reason_fields(self._reason),
            "looks": self._looks,
            "renewals": self._renewals,
            "spoiled": self.frames.discarded,
            "rest_frames": self._rest_frames(),
            **_figures(self._distance),
            "ageing": None if self._ageing is None else self._ageing.health(),
        }

    def _rest_frames(self) -> int:
        running = self._running()
        learner = None if isinstance(running, Reason) else self._learners.get(running.profile.name)
        return learner.frames if learner else 0

    def _begin(self, origin: Origin) -> None:
        self._origin = origin
        # What was learnt belongs to the reference before.
        self._learners, self._batch = {}, None
        self.calibration = origin.calibration
        self._state, self._reason, self._distance = "waiting", None, None

    def _change_state(self, state: State, reason: Reason | None) -> None:
        """Set the state, and publish and log it if it changed;
        new figures in the same reason are no change.
        """
        changed = (state, code_of(reason)) != (self._state, code_of(self._reason))
        self._state, self._reason = state, reason
        if changed:
            _log.info("reference %s%s", state, f": {reason}" if reason else "")
            self._changed()


def _figures(distance: Distance | None) -> dict[str, float | None]:
    """A distance in the form of ``info.bounds``; null if unknown."""
    keys = ("shift_px", "moved_px", "light", "uneven", "contrast", "common_grey", "patch_grey")
    if distance is None:
        return dict.fromkeys(keys)
    drift = distance.drift
    values = (drift.shift_px, drift.moved_px, drift.light, drift.uneven, drift.contrast)
    return {
        key: round(value, 3)
        for key, value in zip(
            keys, (*values, distance.common_grey, distance.patch_grey), strict=True
        )
    }
