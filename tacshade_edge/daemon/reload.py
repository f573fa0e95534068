"""Which settings can change while the daemon runs, and which need a restart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import msgspec

from tacshade_edge.factories import calibrations, checks
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.settings import Document, load
from tacshade_edge.types import Calibration

# The source, the link and its topics, and the robot's line are made once.
RESTART_KEYS = ("sensor_id", "source", "mqtt", "serial", "stitching", "hand_id")


@dataclass(frozen=True, slots=True)
class Reloaded:
    """The settings file's present content, as far as a running daemon can apply it.

    Attributes
    ----------
    document : Document
        The new settings, with the running ones for every key in `RESTART_KEYS`.
    calibration : Calibration or Reason
    waiting : tuple of str
        Keys that changed and need a restart.
    """

    document: Document
    calibration: Calibration | Reason
    waiting: tuple[str, ...]

    @property
    def reason(self) -> Reason | None:
        """Why not all of it is in use; None if all is."""
        if not self.waiting:
            return None
        return Reason(ReasonCode.RESTART, f"restart the daemon to use the new {' and '.join(self.waiting)}")


def reload(running: Document, *, calibrated: bool) -> Reloaded:
    """Read the settings and the calibration again.

    Parameters
    ----------
    running : Document
    calibrated : bool
        Whether there was a calibration, so that there must be one.

    Raises
    ------
    ConfigError
        The settings are bad, or the calibration does not fit the running source.
    """
    new = load(running.path, running.settings.sensor_id if running.several else None)
    checks.check_files(new)
    kept = {key: getattr(running.settings, key) for key in RESTART_KEYS}
    waiting = tuple(key for key, value in kept.items() if getattr(new.settings, key) != value)
    document = replace(new, settings=msgspec.structs.replace(new.settings, **kept))
    find = calibrations.load_calibration if calibrated else calibrations.find_calibration
    return Reloaded(document, find(document), waiting)
