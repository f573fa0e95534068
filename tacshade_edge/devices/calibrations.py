"""Calibrations as every command loads them: one of another version of the program is made again from what it keeps."""

from __future__ import annotations

import logging
import os
from pathlib import Path

from tacshade_edge.core.calibration.inputs import Inputs
from tacshade_edge.devices.files import calibration_file
from tacshade_edge.devices.files.whole_files import write_whole
from tacshade_edge.devices.weights.network import load_networks
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.types import Calibration

_log = logging.getLogger(__name__)


def load(path: str | os.PathLike[str], *, store: bool = True) -> Calibration:
    """Load a calibration, made again if it is of another version and keeps what it was made of.

    Parameters
    ----------
    path : str
    store : bool
        Write what was made again in its place, and keep the old file beside it.

    Raises
    ------
    ConfigError
        It cannot be used.
    """
    version = calibration_file.version_of(path)
    inputs = None if version == calibration_file.VERSION else calibration_file.inputs_in(path)
    if inputs is None:
        return calibration_file.load(path)
    from tacshade_edge.core.calibration.making_again import make_again  # once in an update's life

    _log.warning("%s: of version %s: making it again for version %d", path, version, calibration_file.VERSION)
    try:
        made = make_again(inputs, load_networks())
    except ConfigError as error:
        raise ConfigError(f"{path}: cannot be made again by this version: {error}; calibrate again") from None
    return _stored(Path(path), made, inputs, version) if store else calibration_file.with_crc(made)


def _stored(path: Path, made: Calibration, inputs: Inputs, version: object) -> Calibration:
    kept = path.with_name(f"{path.stem}.v{version}{path.suffix}")
    try:
        write_whole(kept, path.read_bytes())
        stored = calibration_file.save(path, made, inputs)
    except (OSError, DeviceError) as error:
        _log.warning("%s: made again each time, it cannot be stored: %s", path, error)
        return calibration_file.with_crc(made)
    _log.warning("%s: made again; the old file is %s", path, kept)
    return stored
