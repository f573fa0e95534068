"""The reference that following starts from: the calibration's own, a stored or a new one."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tacshade_edge.calibration.files import reference_file
from tacshade_edge.calibration.files.reference_file import (
    LearntLimits,
    Source,
    StoredReference,
    limited,
)
from tacshade_edge.calibration.reference.references import rezero
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.reasons import Reason, ReasonCode, reason_fields
from tacshade_edge.types import U8, Calibration

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Origin:
    """The reference that following starts from, of the calibration's file or of a request
    that outlives a restart.
    """

    # The file's: requests are measured against it, so that they never lead away from it.
    calibrated: Calibration
    calibration: Calibration  # with the limits
    source: Source = "calibration"
    wall_ns: int | None = None
    # Why a stored one is not used, or why this one will not outlive a restart.
    reason: Reason | None = None
    limits: Mapping[str, LearntLimits] = field(default_factory=dict)  # by profile

    def as_dict(self) -> dict[str, Any]:
        return {
            "origin": self.source,
            "wall_ns": self.wall_ns,
            "calibration_crc32": self.calibration.crc32,
            **reason_fields(self.reason),
        }


def restored(calibrated: Calibration, path: Path, unowned: Reason | None = None) -> Origin:
    """The reference that was stored for a calibration, or the calibration's own;
    one stored for another is deleted.
    """
    try:
        stored = reference_file.load(path, calibrated)
    except ConfigError as error:
        _log.warning("%s; using the calibration's own reference", error)
        # Another daemon that owns the file may still use the calibration that it was stored for.
        if error.code is ReasonCode.CALIBRATION_CHANGED and unowned is None:
            with contextlib.suppress(OSError):
                path.unlink()
        return Origin(calibrated, calibrated, reason=error.reason)
    if stored is None:
        return Origin(calibrated, calibrated, reason=unowned)
    taken = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(stored.wall_ns / 1e9))
    on_request = stored.source == "request"
    if on_request:
        _log.info("using the reference taken at %s and stored in %s", taken, path)
    if stored.limits:
        _log.info("using where touches begin as learnt and stored in %s", path)
    wall_ns = stored.wall_ns if on_request else None
    return Origin(
        calibrated, stored.calibration, stored.source, wall_ns, unowned, limits=stored.limits
    )


def requested(
    calibrated: Calibration,
    images: Sequence[U8],
    path: Path,
    unowned: Reason | None = None,
    limits: Mapping[str, LearntLimits] = MappingProxyType({}),
) -> Origin:
    """Take a new reference; store it if no other daemon owns the file.

    Raises ConfigError for unusable images.
    """
    renewed = limited(rezero(calibrated, images), limits)
    taken = StoredReference(renewed, time.time_ns(), limits=limits)
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
    return Origin(calibrated, renewed, "request", taken.wall_ns, reason, limits)
