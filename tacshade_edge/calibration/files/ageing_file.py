"""How a sensor looked at rest on each day: one ``.npz`` file next to the calibration with whose
reference it was compared.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from tacshade_edge.calibration.ageing.wears import COLUMNS, DAY_MAX, DAYS_MAX, History
from tacshade_edge.calibration.files.reference_file import belongs_to
from tacshade_edge.errors import ConfigError
from tacshade_edge.files import npz
from tacshade_edge.files.atomic_files import disk_errors, write_whole
from tacshade_edge.files.npz import Content
from tacshade_edge.quoting import shown
from tacshade_edge.types import Calibration

VERSION = 1
# Of light and lengths that a camera can show; what is beyond was not written by the daemon.
_MOST = 1e3


def path_beside(calibration_path: str | os.PathLike[str]) -> Path:
    """The path of the history for a calibration's file."""
    return Path(calibration_path).with_suffix(".ageing.npz")


def path_beside_reference(reference_path: Path) -> Path:
    """The path of the history for the file of a stored reference (`reference_file`)."""
    return path_beside(reference_path.with_suffix(""))


def save(path: Path, calibrated: Calibration, history: History) -> None:
    """Write the history whole; it survives a power cut. Raises DeviceError."""
    meta = {"version": VERSION, "belongs_to": belongs_to(calibrated), "columns": list(COLUMNS)}
    content = Content(meta, {"days": history.days, "looks": history.looks})
    with disk_errors(path.parent):
        write_whole(path, content.packed())


def load(path: Path, calibrated: Calibration) -> History:
    """Read the history of a calibration, given as in its file; an empty one if there is none, or
    if it is of a calibration with another reference.

    Raises ConfigError.
    """
    if not os.path.lexists(path):
        return History.empty()
    content = npz.read(str(path), "history of references", "the daemon")
    if content.meta.get("version") != VERSION or content.meta.get("columns") != list(COLUMNS):
        found = shown(content.meta.get("version"), 20)
        raise ConfigError(
            f"{path}: found version {found} of the history of references, expected {VERSION}; "
            "delete it, and the daemon begins another"
        )
    if content.meta.get("belongs_to") != belongs_to(calibrated):
        return History.empty()
    try:
        return _history(content)
    except (KeyError, ValueError) as error:
        raise ConfigError(
            f"{path}: not a history of references: {shown(error)}; "
            "delete it, and the daemon begins another"
        ) from None


def _history(content: Content) -> History:
    days, looks = content.arrays["days"], content.arrays["looks"]
    if days.dtype != np.int32 or looks.dtype != np.float32:
        raise ValueError(f"found {days.dtype} days and {looks.dtype} looks")
    if days.ndim != 1 or looks.shape != (len(days), len(COLUMNS)) or len(days) > DAYS_MAX:
        raise ValueError(f"found {days.shape} days and {looks.shape} looks")
    increasing = (np.diff(days.astype(np.int64)) > 0).all()
    if not increasing or not ((days >= 0) & (days <= DAY_MAX)).all():
        raise ValueError("found days that do not increase, or are no dates")
    if not (np.abs(looks) <= _MOST).all():
        raise ValueError("found a look that no camera takes")
    return History(days, looks)
