"""Loads calibrations for every command.

A file of another version is recalibrated from the images that it keeps; its fitted weights stay if
the shipped network still has their layout.
"""

from __future__ import annotations

import logging
import os
import tempfile
from dataclasses import replace
from pathlib import Path

from tacshade_edge.calibration.files import calibration_file, objects_file
from tacshade_edge.calibration.inputs import Inputs
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files.atomic_files import write_whole
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.recording.recording_content import CALIBRATION_NAME, content_of
from tacshade_edge.sensor.inference.network import can_run, load_networks
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.settings import Document
from tacshade_edge.types import Calibration, FittedNetwork

_log = logging.getLogger(__name__)


def load(path: str | os.PathLike[str], *, store: bool = True) -> Calibration:
    """Load a calibration and the objects that were taught, recalibrate one of another version if it
    keeps its images, and with `store` replace its file and keep the old one beside it. Fitted
    networks that cannot run are left out.

    Raises ConfigError.
    """
    calibration = _load(path, store=store)
    known = objects_file.load(objects_file.path_beside(path))
    return replace(calibration, known=known) if known else calibration


def _load(path: str | os.PathLike[str], *, store: bool) -> Calibration:
    # The version alone first: the rest of another version's file may not even be readable.
    version = calibration_file.version_of(path)
    inputs = (
        None if version in (None, calibration_file.VERSION) else calibration_file.inputs_in(path)
    )
    if version is None or inputs is None:
        return _running(path, calibration_file.load(path))
    from tacshade_edge.calibration.calibrate import make_again  # needed only after an update

    found = f"found version {version}, expected {calibration_file.VERSION}"
    _log.warning("%s: %s; recalibrating from the file's images", path, found)
    try:
        fitted, touch = calibration_file.fitted_in(path), calibration_file.touch_in(path)
        made = replace(make_again(inputs, load_networks()), fitted=fitted, touch=touch)
    except ConfigError as error:
        raise ConfigError(
            f"{path}: cannot recalibrate from the file's images: {error}; calibrate again"
        ) from None
    return _running(
        path,
        _stored(Path(path), made, inputs, version) if store else calibration_file.with_crc(made),
    )


def of_recording(recording: Path) -> Calibration | None:
    """A recording's own calibration, whose file stays as it is; None without one.

    Raises ConfigError as `load` does.
    """
    content = content_of(recording)
    if CALIBRATION_NAME not in content:
        return None
    if recording.is_dir():
        return load(recording / CALIBRATION_NAME, store=False)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / CALIBRATION_NAME
        path.write_bytes(content[CALIBRATION_NAME])
        try:
            return load(path, store=False)
        except ConfigError as error:
            # The file is gone when a person reads this.
            text = str(error).replace(str(path), f"{recording}: its {CALIBRATION_NAME}")
            raise ConfigError(text) from None


def fits_to_renew(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Profiles whose fitted weights in a file do not have the shipped network's layout.

    Raises ConfigError.
    """
    return tuple(
        name
        for name, fitted in calibration_file.fitted_in(path).items()
        if not _can_run(name, fitted)
    )


def _running(path: str | os.PathLike[str], calibration: Calibration) -> Calibration:
    """The calibration without the fitted networks that cannot run."""
    can_run = {
        name: fitted for name, fitted in calibration.fitted.items() if _can_run(name, fitted)
    }
    if len(can_run) == len(calibration.fitted):
        return calibration
    renew = ", ".join(sorted(set(calibration.fitted) - set(can_run)))
    text = f"the networks have changed since {renew} was fitted, so the shipped networks are in use"
    _log.warning("%s: %s; run calibrate --fit again", path, text)
    return calibration_file.with_crc(replace(calibration, fitted=can_run))


def _can_run(profile: str, fitted: FittedNetwork) -> bool:
    network = PROFILES[profile].network if profile in PROFILES else None
    return network is not None and can_run(network, fitted)


def _stored(path: Path, made: Calibration, inputs: Inputs, version: int) -> Calibration:
    # The old file stays: an older version of the program can read only that.
    kept = path.with_name(f"{path.stem}.v{version}{path.suffix}")
    try:
        write_whole(kept, path.read_bytes())
        stored = calibration_file.save(path, made, inputs)
    except (OSError, DeviceError) as error:
        text = "the daemon recalibrates at each start because it cannot store the new calibration"
        _log.warning("%s: %s: %s", path, text, error)
        return calibration_file.with_crc(made)
    _log.warning("%s: recalibrated from the file's images and kept the old file as %s", path, kept)
    return stored


def find_calibration(document: Document, *, store: bool = False) -> Calibration | Reason:
    """`load_calibration`, or a reason that explains how to make one if there is no file.

    Raises ConfigError if it cannot be used.
    """
    path = document.settings.calibration
    try:
        os.stat(path)
    except FileNotFoundError:
        text = f"not calibrated: found no file {path}; {how_to_calibrate(document)}"
        return Reason(ReasonCode.NOT_CALIBRATED, text)
    except OSError:
        pass  # loading reports it
    return load_calibration(document, store=store)


def image_size_px(document: Document) -> tuple[int, int] | None:
    """Width and height of the calibration's images, px; None without a usable calibration."""
    try:
        return size_px(find_calibration(document))
    except ConfigError:
        return None  # the check of the calibration reports it


def size_px(calibration: Calibration | Reason) -> tuple[int, int] | None:
    """Width and height of a calibration's images, px; None if there is none."""
    if isinstance(calibration, Reason):
        return None
    return calibration.image_width_px, calibration.image_height_px


def how_to_calibrate(document: Document) -> str:
    """The commands that make the calibration that the settings name, as text."""
    return (
        "while nothing else uses the camera, run tacshade-edge capture DIR --config "
        f"{document.path}, then tacshade-edge calibrate --sensor DIR/SENSOR.yaml --reference "
        f"DIR/reference_*.png --presses DIR/PRESSES.csv --out {document.settings.calibration}"
    )


def load_calibration(document: Document, *, store: bool = False) -> Calibration:
    """Load the calibration that the settings name, and check that it fits the source.

    Raises ConfigError.
    """
    settings = document.settings
    try:
        calibration = load(settings.calibration, store=store)
    except ConfigError as error:
        raise ConfigError(f"{document.where('calibration')}: {error}") from error
    source, expected = settings.source, (calibration.image_width_px, calibration.image_height_px)
    try:
        misfit = source.size_misfit(expected)
    except ConfigError as error:
        raise ConfigError(f"{document.where('source', source.names)}: {error}") from None
    if misfit:
        raise ConfigError(f"{document.where('source', misfit[0])}: {misfit[1]}")
    return calibration
