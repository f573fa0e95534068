"""Where the reference comes from: the calibration's file, or a request that outlives a restart."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tacshade_edge.core.calibration.reference.references import rezero
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.reasons import Reason, ReasonCode, reason_fields
from tacshade_edge.storage.calibration import reference_file
from tacshade_edge.storage.calibration.calibration_file import with_crc
from tacshade_edge.storage.calibration.reference_file import StoredReference
from tacshade_edge.types import U8, Calibration

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Origin:
    """The reference that following starts from.

    Attributes
    ----------
    calibrated : Calibration
        As in its file; requests are measured against it, so that no number of them leads away from the geometry.
    calibration : Calibration
        The calibration with this reference.
    source : str
    wall_ns : int or None
        When a request took it.
    reason : Reason or None
        Why a stored reference is not used, or why this one will not outlive a restart.
    """

    calibrated: Calibration
    calibration: Calibration
    source: Literal["calibration", "request"] = "calibration"
    wall_ns: int | None = None
    reason: Reason | None = None

    def as_dict(self) -> dict[str, Any]:
        """The content for ``info``."""
        return {
            "origin": self.source,
            "wall_ns": self.wall_ns,
            "calibration_crc32": self.calibration.crc32,
            **reason_fields(self.reason),
        }


def restored(calibrated: Calibration, path: Path, unowned: Reason | None = None) -> Origin:
    """The reference that was stored for a calibration, or the calibration's own.

    A reference stored for another calibration is deleted, so that it is reported once and never meets a later file,
    except if another daemon owns it (`unowned`).
    """
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


def requested(calibrated: Calibration, images: Sequence[U8], path: Path, unowned: Reason | None = None) -> Origin:
    """Take a new reference and store it if possible, but not if another daemon owns the file (`unowned`).

    Raises
    ------
    ConfigError
        The images cannot be used.
    """
    taken = StoredReference(with_crc(rezero(calibrated, images)), time.time_ns())
    reason = unowned
    if reason is None:
        try:
            reference_file.save(path, calibrated, taken)
        except DeviceError as error:
            reason = error.reason
    if reason is not None:
        reason = Reason(reason.code, f"{reason}; this reference lasts only until the next start or reload")
    _log.info("took a new reference from %d frames%s", len(images), f": {reason}" if reason else "")
    return Origin(calibrated, taken.calibration, "request", taken.wall_ns, reason)
