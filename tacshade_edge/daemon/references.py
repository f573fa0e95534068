"""The reference in use: taken on request, or followed from frames of the resting sensor."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from tacshade_edge.core.calibration.reference import references
from tacshade_edge.core.calibration.reference.references import Distance, rezero
from tacshade_edge.daemon.observer import STITCHED_S, FrameObserver, FrameResult, Reply
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.free_memory import return_free_memory
from tacshade_edge.protocol.results import ReferenceTaken
from tacshade_edge.reasons import Reason, ReasonCode, code_of, reason_fields
from tacshade_edge.storage.atomic_files import FolderLock
from tacshade_edge.storage.calibration import reference_file
from tacshade_edge.storage.calibration.calibration_file import with_crc
from tacshade_edge.storage.calibration.objects_file import Known
from tacshade_edge.storage.calibration.reference_file import StoredReference
from tacshade_edge.types import U8, Calibration, Frame, Need, Reconstruction

_log = logging.getLogger(__name__)

REFERENCE_FRAMES = UNTOUCHED_FRAMES = 10
REFERENCE_TIMEOUT_S = 5.0
REST_S = 10.0  # a dent after a release is gone after 3 s; a soft skin under a long press needs a little more
PERIOD_S = 60.0  # what the reference follows changes over minutes and years
GAP_S = 3.0  # after a longer gap between frames, nobody knows what touched


def _touches(result: Reconstruction) -> bool:
    return result.contact or result.touched


class UntouchedFrames:
    """Ten frames of a sensor at rest once per `PERIOD_S` of the frames' time; a touched, invalid or doubtful frame ends
    them. The reconstruct thread passes in every frame, the main thread takes the result.
    """

    def __init__(self) -> None:
        self.at_rest = False  # nothing touched in the latest frame
        self.discarded = 0  # batches that were begun and not finished
        self._images: list[U8] = []
        self._finished: list[U8] | Reason | None = None  # set by one thread, cleared by the other
        self._last_ns: int | None = None
        self._touched_ns = self._due_ns = 0

    def take(self) -> list[U8] | Reason | None:
        """The frames, or the doubt about one of them; None if there are none. Until taken, they block further ones."""
        if (finished := self._finished) is not None:
            self._finished = None
        return finished

    def see(self, frame: Frame, result: Reconstruction | None) -> None:
        now_ns, last_ns = frame.t_ns, self._last_ns
        self._last_ns = now_ns
        known = last_ns is not None and 0 <= now_ns - last_ns <= GAP_S * 1e9
        self.at_rest = result is not None and result.valid and not _touches(result)
        if not known or not self.at_rest:
            self._touched_ns = now_ns
            self._discard()
        elif self._finished is None and now_ns >= max(
            self._due_ns, self._touched_ns + int(REST_S * 1e9)
        ):
            doubt = result.degraded if result else None
            if doubt:
                self._discard()
            else:
                self._images.append(frame.image)
            if doubt or len(self._images) == UNTOUCHED_FRAMES:
                self._due_ns = now_ns + int(PERIOD_S * 1e9)
                self._finished, self._images = doubt or self._images, []

    def _discard(self) -> None:
        self.discarded += bool(self._images)
        self._images = []


@dataclass(frozen=True, slots=True, eq=False)
class Origin:
    """The reference that following starts from, of the calibration's file or of a request that outlives a restart."""

    calibrated: Calibration  # the file's: requests are measured against it, so that they never lead away from it
    calibration: Calibration
    source: Literal["calibration", "request"] = "calibration"
    wall_ns: int | None = None
    reason: Reason | None = (
        None  # why a stored one is not used, or why this one will not outlive a restart
    )

    def as_dict(self) -> dict[str, Any]:
        return {
            "origin": self.source,
            "wall_ns": self.wall_ns,
            "calibration_crc32": self.calibration.crc32,
            **reason_fields(self.reason),
        }


def restored(calibrated: Calibration, path: Path, unowned: Reason | None = None) -> Origin:
    """The reference that was stored for a calibration, or the calibration's own; one stored for another is deleted."""
    try:
        stored = reference_file.load(path, calibrated)
    except ConfigError as error:
        _log.warning("%s; using the calibration's own reference", error)
        if error.code is ReasonCode.CALIBRATION_CHANGED and unowned is None:
            with contextlib.suppress(OSError):
                path.unlink()
        return Origin(calibrated, calibrated, reason=error.reason)
    if stored is None:
        return Origin(calibrated, calibrated, reason=unowned)
    taken = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(stored.wall_ns / 1e9))
    _log.info("using the reference taken at %s and stored in %s", taken, path)
    return Origin(calibrated, stored.calibration, "request", stored.wall_ns, unowned)


def requested(
    calibrated: Calibration, images: Sequence[U8], path: Path, unowned: Reason | None = None
) -> Origin:
    """Take a new reference; store it if no other daemon owns the file. Raises ConfigError for unusable images."""
    taken = StoredReference(with_crc(rezero(calibrated, images)), time.time_ns())
    reason = unowned
    if reason is None:
        try:
            reference_file.save(path, calibrated, taken)
        except DeviceError as error:
            reason = error.reason
    if reason is not None:
        reason = Reason(
            reason.code, f"{reason}; this reference lasts only until the next start or reload"
        )
    _log.info("took a new reference from %d frames%s", len(images), f": {reason}" if reason else "")
    return Origin(calibrated, taken.calibration, "request", taken.wall_ns, reason)


State = Literal["waiting", "following", "stopped", "held"]


class References(FrameObserver):
    """Where the reference began, and how far it has followed from there; handles ``req/reference``. `use` receives each
    new one; `changed` is called when only its state is new; while a recording `held` it, it does not follow.
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
    ) -> None:
        self._sensor_id = sensor_id
        self._path = path
        self._use, self._changed, self._held = use, changed, held
        self._lock: FolderLock | None = None
        self._unowned: Reason | None = None
        self.frames = UntouchedFrames()
        self._request: tuple[Reply, float] | None = None  # and its deadline
        self._images: list[U8] | None = None  # what it collects, in the reconstruct thread
        self._collected: list[U8] | Reason | None = None
        self._looks = self._renewals = 0
        self._state: State = "waiting"
        self._reason: Reason | None = None
        self._distance: Distance | None = None
        self._origin: Origin | Reason
        self.calibration: Calibration | Reason
        self.reload(calibrated, path)

    def reload(self, calibrated: Calibration | Reason, path: Path) -> None:
        if path != self._path:
            self.stop()
            self._path = path
        if isinstance(calibrated, Reason):
            self._origin = self.calibration = calibrated
        else:
            self._own_file()
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
        self._collected, self._images = None, []

    def need(self) -> Need:
        return Need.CONTACT if self._images is None else Need.DEPTH

    def see(self, seen: FrameResult) -> None:
        self.frames.see(seen.frame, seen.reconstruction)
        images, result = self._images, seen.reconstruction
        if images is None or result is None or self._collected is not None:
            return
        what = f"frame {seen.frame.seq}: found"
        if not result.valid:
            text = f"{what} an invalid frame ({result.reason}), expected a valid frame of an untouched sensor"
            self._collected = Reason(ReasonCode.FRAME_INVALID, text)
        elif _touches(result):
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
                text = f"received fewer than {REFERENCE_FRAMES} frames within {REFERENCE_TIMEOUT_S:.0f} s"
                images = Reason(ReasonCode.TIMEOUT, text)
            if images is not None:
                self._request = self._images = None
                reply(images if isinstance(images, Reason) else self._taken(images))
        if (frames := self.frames.take()) is not None:
            self.follow(frames)

    def stop(self, timeout_s: float = 0) -> None:
        """Let another daemon have the stored reference."""
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
            if (
                error.code is ReasonCode.IN_USE
            ):  # a folder that cannot be written is reported when something is stored
                _log.warning("%s; this daemon does not store new references", error)
                self._unowned = error.reason

    def _taken(self, images: Sequence[U8]) -> ReferenceTaken | Reason:
        """Start over with images of the resting sensor, or return why they cannot be used."""
        if isinstance(self._origin, Reason):
            return self._origin
        self._own_file()
        try:
            origin = requested(self._origin.calibrated, images, self._path, self._unowned)
        except ConfigError as error:
            return Reason(ReasonCode.REFERENCE_INVALID, str(error))
        self._begin(origin)
        taken = origin.calibration
        self._use(taken)
        return ReferenceTaken(len(images), taken.crc32, taken.noise_grey, unstored=origin.reason)

    def follow(self, frames: list[U8] | Reason) -> None:
        """Follow frames of the sensor at rest, unless there was a doubt about one of them, or a recording goes on."""
        if isinstance(self._origin, Reason) or isinstance(self.calibration, Reason):
            return
        if self._held():
            self._change_state("held", None)
            return
        self._looks += 1
        if isinstance(frames, Reason):
            self._change_state("stopped", frames)
            return
        followed = references.follow(self._origin.calibration, self.calibration, frames)
        return_free_memory()  # the heap kept 7 MB
        self._distance = followed.distance
        self._change_state("stopped" if followed.reason else "following", followed.reason)
        # A new reference during a contact would be a step in its heights; the next frames at rest yield it again.
        if followed.calibration is not None and self.frames.at_rest:
            self.calibration = with_crc(followed.calibration)
            self._renewals += 1
            _log.debug("reference renewed: %s", followed.distance)
            self._use(self.calibration)

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
            **_figures(self._distance),
        }

    def _begin(self, origin: Origin) -> None:
        self._origin = origin
        self.calibration = origin.calibration
        self._state, self._reason, self._distance = "waiting", None, None

    def _change_state(self, state: State, reason: Reason | None) -> None:
        """Set the state, and publish and log it if it changed; new figures in the same reason are no change."""
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
