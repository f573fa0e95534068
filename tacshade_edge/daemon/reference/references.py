"""The reference in use. Only the main thread uses it, except that the reconstruct thread calls `see`."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from tacshade_edge.core.calibration.reference import following
from tacshade_edge.core.calibration.reference.following import Distance
from tacshade_edge.daemon.pipeline.observer import STITCHED_S, FrameObserver, FrameResult
from tacshade_edge.daemon.reference.origin import Origin, requested, restored
from tacshade_edge.daemon.reference.untouched import UntouchedFrames
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.free_memory import return_free_memory
from tacshade_edge.protocol.results import ReferenceTaken
from tacshade_edge.reasons import Reason, ReasonCode, code_of, reason_fields
from tacshade_edge.storage.calibration.calibration_file import with_crc
from tacshade_edge.storage.folder_lock import FolderLock
from tacshade_edge.types import U8, Calibration

_log = logging.getLogger(__name__)

State = Literal["waiting", "following", "stopped", "held"]


class References(FrameObserver):
    """Where the reference began, and how far it has followed from there.

    Parameters
    ----------
    calibrated : Calibration or Reason
        As in its file, or why there is none.
    path : Path
        File of the stored reference.
    sensor_id : str
        Names this daemon to another one that wants the same file.

    Attributes
    ----------
    calibration : Calibration or Reason
        The calibration with the reference in use.
    frames : UntouchedFrames
    """

    health_key = "reference"
    stop_s = STITCHED_S

    def __init__(self, calibrated: Calibration | Reason, path: Path, sensor_id: str) -> None:
        self._sensor_id = sensor_id
        self._path = path
        self._lock: FolderLock | None = None
        self._unowned: Reason | None = None
        self.frames = UntouchedFrames()
        self._looks = self._renewals = 0
        self._state: State = "waiting"
        self._reason: Reason | None = None
        self._distance: Distance | None = None
        self._origin: Origin | Reason
        self.calibration: Calibration | Reason
        self.reload(calibrated, path)

    def reload(self, calibrated: Calibration | Reason, path: Path) -> None:
        """Start again from the present files."""
        if path != self._path:
            self.close()
            self._path = path
        if isinstance(calibrated, Reason):
            self._origin = self.calibration = calibrated
        else:
            self._own_file()
            self._begin(restored(calibrated, path, self._unowned))

    def see(self, seen: FrameResult) -> None:
        """Take a frame to follow from; called in the reconstruct thread."""
        self.frames.see(seen.frame, seen.reconstruction)

    def stop(self, timeout_s: float) -> None:
        """Let another daemon have the stored reference."""
        self.close()

    def close(self) -> None:
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
            self._lock = FolderLock(self._path.parent, f"sensor {self._sensor_id}", file=self._path.name)
        except DeviceError as error:
            if error.code is ReasonCode.IN_USE:  # a folder that cannot be written is reported when something is stored
                _log.warning("%s; this daemon does not store new references", error)
                self._unowned = error.reason

    def take(self, images: Sequence[U8]) -> ReferenceTaken:
        """Start over with images of the resting sensor.

        Raises
        ------
        ConfigError
            The images cannot be used, or there is no calibration.
        """
        if isinstance(self._origin, Reason):
            raise ConfigError(self._origin.text, code=self._origin.code)
        self._own_file()
        origin = requested(self._origin.calibrated, images, self._path, self._unowned)
        self._begin(origin)
        taken = origin.calibration
        return ReferenceTaken(len(images), taken.crc32, taken.noise_grey, unstored=origin.reason)

    def follow(self, held: bool) -> bool:
        """Follow if frames for it have come; return True if `calibration` or the content of ``info`` has changed.

        Parameters
        ----------
        held : bool
            Whether the reference must stay, because a recording contains it.
        """
        taken, calibration = self.frames.take(), self.calibration
        if taken is None or isinstance(self._origin, Reason) or isinstance(calibration, Reason):
            return False
        if held:
            return self._change_state("held", None)
        self._looks += 1
        if isinstance(taken, Reason):
            return self._change_state("stopped", taken)
        followed = following.follow(self._origin.calibration, calibration, taken)
        return_free_memory()  # the heap kept 7 MB
        self._distance = followed.distance
        changed = self._change_state("stopped" if followed.reason else "following", followed.reason)
        # A new reference during a contact would be a step in its heights; the next frames at rest yield it again.
        if followed.calibration is None or not self.frames.at_rest:
            return changed
        self.calibration = with_crc(followed.calibration)
        self._renewals += 1
        _log.debug("reference renewed: %s", followed.distance)
        return True

    def info(self) -> dict[str, Any] | None:
        """The content for ``info``: where the reference began, its bounds from there, and whether it reached them."""
        if isinstance(self._origin, Reason):
            return None
        disc = self._origin.calibration.geometry.disc
        state = {"state": self._state, **reason_fields(self._reason, "stopped")}
        return {**self._origin.as_dict(), "bounds": following.bounds(disc), **state}

    def health(self) -> dict[str, Any]:
        """The report for ``health``: how it follows, and how far the latest frames at rest were from where it began."""
        return {
            "state": self._state,
            **reason_fields(self._reason),
            "looks": self._looks,
            "renewals": self._renewals,
            "spoiled": self.frames.spoiled,
            **_figures(self._distance),
        }

    def _begin(self, origin: Origin) -> None:
        self._origin = origin
        self.calibration = origin.calibration
        self._state, self._reason, self._distance = "waiting", None, None

    def _change_state(self, state: State, reason: Reason | None) -> bool:
        """Set the state and return whether it changed; new figures in the same reason are no change."""
        changed = (state, code_of(reason)) != (self._state, code_of(self._reason))
        if changed:
            _log.info("reference %s%s", state, f": {reason}" if reason else "")
        self._state, self._reason = state, reason
        return changed


def _figures(distance: Distance | None) -> dict[str, float | None]:
    """A distance in the form of ``info.bounds``; null if unknown."""
    keys = ("shift_px", "moved_px", "light", "uneven", "contrast", "common_grey", "patch_grey")
    if distance is None:
        return dict.fromkeys(keys)
    drift = distance.drift
    values = (drift.shift_px, drift.moved_px, drift.light, drift.uneven, drift.contrast)
    return {
        key: round(value, 3)
        for key, value in zip(keys, (*values, distance.common_grey, distance.patch_grey), strict=True)
    }
