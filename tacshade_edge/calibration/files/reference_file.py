"""What a running daemon took and learnt: the reference, and the limits of untouched frames, in one
``.npz`` file next to the calibration that they belong to.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from tacshade_edge.calibration.files.calibration_file import REFERENCE_ARRAYS, with_crc
from tacshade_edge.errors import ConfigError
from tacshade_edge.files import npz
from tacshade_edge.files.atomic_files import disk_errors, write_whole
from tacshade_edge.files.npz import Content, parts_of, record_of
from tacshade_edge.quoting import shown
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.types import U8, Calibration, RestLimits

VERSION = 2


Source = Literal["calibration", "request"]


@dataclass(frozen=True, slots=True)
class LearntLimits:
    """A profile's limits as the daemon learnt them, and the first ones, near which they stay."""

    now: RestLimits
    first: RestLimits


@dataclass(frozen=True, slots=True)
class StoredReference:
    """The calibration with a reference that the daemon took, or its own, and the limits that it
    learnt (`limited`); and the Unix time when it took the reference, or learnt them.
    """

    calibration: Calibration
    wall_ns: int
    source: Source = "request"
    limits: Mapping[str, LearntLimits] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class _File:
    version: int
    belongs_to: int
    # Any later time has a year that no calendar function takes.
    wall_ns: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    noise_grey: float
    reference_white: U8
    reference_grey: U8
    source: Source = "request"
    limits: Mapping[str, LearntLimits] = field(default_factory=dict)  # by profile
    limits_of: int = 0  # CRC-32 of the calibration for which they were learnt


def path_beside(calibration_path: str | os.PathLike[str]) -> Path:
    """The path of the reference for a calibration's file;
    two sensors' files in one folder get different ones.
    """
    return Path(calibration_path).with_suffix(".reference.npz")


def save(path: Path, calibrated: Calibration, reference: StoredReference) -> None:
    """Write a reference of `calibrated`, which is as in its file; it survives a power cut.

    Raises DeviceError.
    """
    taken = reference.calibration
    arrays = taken.reference_white, taken.reference_grey
    file = _File(
        VERSION,
        belongs_to(calibrated),
        reference.wall_ns,
        taken.noise_grey,
        *arrays,
        source=reference.source,
        limits_of=calibrated.crc32 if reference.limits else 0,
    )
    meta, images = parts_of(file)
    if reference.limits:
        meta["limits"] = {name: asdict(each) for name, each in reference.limits.items()}
    with disk_errors(path.parent):
        write_whole(path, Content(meta, images).packed())


def load(path: Path, calibrated: Calibration) -> StoredReference | None:
    """Read the stored reference of a calibration, given as in its file; None if there is none.

    Raises ConfigError if it is unreadable, damaged, or (`ReasonCode.CALIBRATION_CHANGED`) of
    another calibration. Limits of one that differs in anything, such as its networks, are left out.
    """
    # A dangling link is a mistake to report, not an absent file.
    if not os.path.lexists(path):
        return None
    content = npz.read(str(path), "stored reference", "the daemon for `req/reference`")
    if content.meta.get("version") != VERSION:
        raise ConfigError(f"{path}: not a version {VERSION} reference file; take a new reference")
    if content.meta.get("belongs_to") != belongs_to(calibrated):
        text = f"{path}: the stored reference belongs to another calibration; take a new reference"
        raise ConfigError(text, code=ReasonCode.CALIBRATION_CHANGED)
    try:
        file = record_of(_File, {**content.meta, **content.arrays})
        images = {name: getattr(file, name) for name in REFERENCE_ARRAYS}
        if any(image.shape != getattr(calibrated, name).shape for name, image in images.items()):
            raise ValueError("found images of another size than the calibration's")
        calibration = replace(calibrated, noise_grey=file.noise_grey, **images)
    except ValueError as error:
        raise ConfigError(
            f"{path}: not a reference file: {shown(error)}; take a new reference"
        ) from None
    # Limits depend on the networks, a reference does not: an update keeps the latter only.
    limits = file.limits if file.limits_of == calibrated.crc32 else {}
    return StoredReference(limited(calibration, limits), file.wall_ns, file.source, limits)


def limited(calibration: Calibration, limits: Mapping[str, LearntLimits]) -> Calibration:
    """A calibration with the limits that were learnt."""
    now = {name: each.now for name, each in limits.items()}
    return with_crc(replace(calibration, rest={**calibration.rest, **now}))


def belongs_to(calibrated: Calibration) -> int:
    """CRC-32 of the values that a new reference replaces or uses;
    recalibration after an update keeps it.
    """
    disc = calibrated.geometry.disc
    meta = {
        "disc": [disc.row_c, disc.col_c, disc.radius_px],
        "binarisation": calibrated.binarisation,
    }
    return Content(meta, {name: getattr(calibrated, name) for name in REFERENCE_ARRAYS}).crc32
