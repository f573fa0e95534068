"""Reads the settings and the calibration again while the daemon runs, and looks for a calibration
that appears.
"""

from __future__ import annotations

import os
from dataclasses import replace

import msgspec

from tacshade_edge.calibration import loading
from tacshade_edge.daemon.named_files import check_files
from tacshade_edge.reasons import Reason
from tacshade_edge.settings import Document, load
from tacshade_edge.settings.model import RESTART_KEYS
from tacshade_edge.types import Calibration


def reload(
    running: Document, *, calibrated: bool
) -> tuple[Document, Calibration | Reason, tuple[str, ...]]:
    """Read the settings and the calibration again; there must be one if there was (`calibrated`).

    The result has the running settings for every key in `RESTART_KEYS`, and names those that
    changed. Raises ConfigError.
    """
    new = load(running.path, running.settings.sensor_id if running.several else None)
    # Before anything is replaced: a reload that fails changes nothing.
    check_files(new)
    kept = {key: getattr(running.settings, key) for key in RESTART_KEYS}
    waiting = tuple(key for key, value in kept.items() if getattr(new.settings, key) != value)
    document = replace(new, settings=msgspec.structs.replace(new.settings, **kept))
    # A daemon that waits for its first calibration goes on to wait if there still is none.
    find = loading.load_calibration if calibrated else loading.find_calibration
    return document, find(document), waiting


class CalibrationWatch:
    """Notices that a calibration's file appeared or was written, each version of it once."""

    def __init__(self) -> None:
        self._seen_ns: int | None = None  # st_mtime_ns

    def written(self, path: str) -> bool:
        """Whether there is a file, or another version of it, since the last call."""
        try:
            written_ns = os.stat(path).st_mtime_ns
        except OSError:
            return False
        # Noted before it is read: a file that cannot be used is reported once, not each second.
        seen_ns, self._seen_ns = self._seen_ns, written_ns
        return written_ns != seen_ns
