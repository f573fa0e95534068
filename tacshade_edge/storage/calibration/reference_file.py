"""The reference that a running daemon took: one ``.npz`` file next to the calibration that it belongs to."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tacshade_edge.errors import ConfigError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.storage import checked_npz
from tacshade_edge.storage.atomic_files import disk_errors, sync, write_whole
from tacshade_edge.storage.calibration.calibration_file import REFERENCE_ARRAYS, with_crc
from tacshade_edge.storage.checked_npz import Content
from tacshade_edge.types import Calibration

VERSION = 2


@dataclass(frozen=True, slots=True)
class StoredReference:
    """A reference that the daemon took.

    Attributes
    ----------
    calibration : Calibration
        The calibration with this reference.
    wall_ns : int
        Unix time when it was taken.
    """

    calibration: Calibration
    wall_ns: int


def path_beside(calibration_path: str | os.PathLike[str]) -> Path:
    """The path of the reference for a calibration's file; two sensors' files in one folder get different ones."""
    return Path(calibration_path).with_suffix(".reference.npz")


def save(path: Path, calibrated: Calibration, reference: StoredReference) -> None:
    """Write a reference whole, so that it survives a power cut.

    Parameters
    ----------
    path : Path
    calibrated : Calibration
        The calibration that it belongs to, as in its file.
    reference : StoredReference

    Raises
    ------
    DeviceError
        The file cannot be written.
    """
    calibration = reference.calibration
    meta = {
        "version": VERSION,
        "belongs_to": belongs_to(calibrated),
        "wall_ns": reference.wall_ns,
        "noise_grey": calibration.noise_grey,
    }
    content = Content(meta, {name: getattr(calibration, name) for name in REFERENCE_ARRAYS})
    with disk_errors(path.parent):
        write_whole(path, content.packed())
        sync(path.parent)


def load(path: Path, calibrated: Calibration) -> StoredReference | None:
    """Read the stored reference of a calibration, given as in its file; None if there is none.

    Raises
    ------
    ConfigError
        Unreadable, damaged, not a reference, or (`ReasonCode.CALIBRATION_CHANGED`) of another calibration.
    """
    if not os.path.lexists(path):
        return None
    content, _ = checked_npz.read(str(path), "stored reference", "the daemon for `req/reference`")
    meta, arrays = content.meta, content.arrays
    if meta.get("version") != VERSION or set(arrays) != set(REFERENCE_ARRAYS):
        raise ConfigError(f"{path}: not a version {VERSION} reference file; take a new reference")
    if meta.get("belongs_to") != belongs_to(calibrated):
        text = f"{path}: the stored reference belongs to another calibration; take a new reference"
        raise ConfigError(text, code=ReasonCode.CALIBRATION_CHANGED)
    shape = (calibrated.image_height_px, calibrated.image_width_px)
    noise_grey, wall_ns = meta.get("noise_grey"), meta.get("wall_ns")
    fits = all(array.shape == shape and array.dtype == np.uint8 for array in arrays.values())
    if not fits or not isinstance(noise_grey, float) or not isinstance(wall_ns, int):
        raise ConfigError(f"{path}: not a reference file; take a new reference")
    try:
        calibration = replace(calibrated, noise_grey=noise_grey, **arrays)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}; take a new reference") from None
    return StoredReference(with_crc(calibration), wall_ns)


def belongs_to(calibrated: Calibration) -> int:
    """CRC-32 of the values that a new reference replaces or uses; recalibration after an update keeps it."""
    disc = calibrated.geometry.disc
    meta = {"disc": [disc.row_c, disc.col_c, disc.radius_px], "binarisation": calibrated.binarisation}
    return Content(meta, {name: getattr(calibrated, name) for name in REFERENCE_ARRAYS}).crc32
