"""The calibration as one ``.npz``: versioned, checksummed, written whole or not at all."""

from __future__ import annotations

import io
import json
import os
import tokenize
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.devices.files.whole_files import write_whole
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.types import Calibration, Disc, Fit, Geometry, ProfileFit

VERSION = 6
"""Also of the networks: factors are fitted to the weights shipped then (tests/devices/weights/test_network.py)."""
# What numpy and zipfile raise on damaged bytes (TypeError: a .npy; RuntimeError: a flag or method zipfile lacks).
_DAMAGE = (
    KeyError,
    ValueError,
    TypeError,
    EOFError,
    RuntimeError,
    MemoryError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
_ARRAYS = ("reference_white", "reference_grey")


def fit_figures(fit: Fit | None) -> dict[str, float]:
    """A fit under flat keys, as the file and the commands' JSON have it; a profile's begin with its name."""
    if fit is None:
        return {}
    figures: dict[str, float] = {
        "presses": float(fit.presses),
        "agreement_mae_mm": fit.agreement_mae_mm,
        "position_mae_mm": fit.position_mae_mm,
    }
    for name, profile in fit.profiles.items():
        figures[f"{name}_presses"] = float(profile.presses)
        figures[f"{name}_depth_mae_mm"] = profile.depth_mae_mm
        figures[f"{name}_depth_worst_mm"] = profile.depth_worst_mm
    return figures


def _fit(figures: dict[str, float]) -> Fit | None:
    """What `fit_figures` made flat."""
    if not figures:
        return None
    suffix = "_depth_mae_mm"
    names = [key.removesuffix(suffix) for key in figures if key.endswith(suffix)]
    return Fit(
        presses=int(figures["presses"]),
        agreement_mae_mm=figures["agreement_mae_mm"],
        position_mae_mm=figures["position_mae_mm"],
        profiles={
            name: ProfileFit(
                int(figures[f"{name}_presses"]), figures[f"{name}_depth_mae_mm"], figures[f"{name}_depth_worst_mm"]
            )
            for name in names
        },
    )


def _content(calibration: Calibration) -> tuple[bytes, dict[str, Any]]:
    """Canonical JSON of the scalars, and the arrays."""
    geometry, disc = calibration.geometry, calibration.geometry.disc
    meta = {
        "version": VERSION,
        "skin_radius_mm": geometry.skin_radius_mm,
        "camera_distance_mm": geometry.camera_distance_mm,
        "visible_half_angle_deg": geometry.visible_half_angle_deg,
        "row_c": disc.row_c,
        "col_c": disc.col_c,
        "radius_px": disc.radius_px,
        "polarity": calibration.polarity,
        "binarisation": calibration.binarisation,
        "pitch_px": calibration.pitch_px,
        "noise_grey": calibration.noise_grey,
        "alpha": calibration.alpha,
        "factors": dict(calibration.factors),
        "fit": fit_figures(calibration.fit),
        "flange_T_sensor": list(calibration.flange_T_sensor),
    }
    return json.dumps(meta, sort_keys=True).encode(), {name: getattr(calibration, name) for name in _ARRAYS}


def _crc32(meta: bytes, arrays: dict[str, Any]) -> int:
    crc = zlib.crc32(meta)
    for name in arrays:
        array = np.ascontiguousarray(arrays[name])
        crc = zlib.crc32(f"{name}{array.dtype.str}{array.shape}".encode(), crc)
        crc = zlib.crc32(array.tobytes(), crc)
    return crc


def with_crc(calibration: Calibration) -> Calibration:
    """The same calibration with the checksum of its content."""
    return replace(calibration, crc32=_crc32(*_content(calibration)))


def save(path: str | os.PathLike[str], calibration: Calibration) -> Calibration:
    """Write a calibration; readers see the old file or the whole new one.

    Returns
    -------
    Calibration
        With its `crc32`.

    Raises
    ------
    DeviceError
        The file cannot be written.
    """
    stored = with_crc(calibration)
    meta, arrays = _content(stored)
    stream = io.BytesIO()
    np.savez_compressed(stream, meta=np.frombuffer(meta, dtype=np.uint8), crc32=np.uint32(stored.crc32), **arrays)
    try:
        write_whole(Path(path), stream.getvalue())
    except OSError as error:
        raise DeviceError(f"{path}: cannot write the calibration: {error.strerror or error}") from None
    return stored


def load(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration.

    Raises
    ------
    ConfigError
        Absent, not a calibration, another version, damaged, or of a sensor that cannot be.
    """
    name = os.fspath(path)
    try:
        with open(name, "rb") as stream, np.load(stream, allow_pickle=False) as npz:
            meta = npz["meta"].tobytes()
            # In the file's order; another version has other arrays, and its checksum is of those.
            arrays = {key: npz[key] for key in npz.files if key not in ("meta", "crc32")}
            crc = int(npz["crc32"])
    except OSError as error:
        raise ConfigError(
            f"{name}: cannot read the calibration: {error.strerror or 'not an .npz file'}; "
            "expected a file written by `tacshade-edge calibrate`"
        ) from None
    except _DAMAGE:
        raise ConfigError(
            f"{name}: not a calibration, or damaged; expected a file written by `tacshade-edge calibrate`"
        ) from None
    if _crc32(meta, arrays) != crc:
        raise ConfigError(f"{name}: damaged: its checksum is {_crc32(meta, arrays):08x}, {crc:08x} is stored in it")
    try:
        return _from_content(name, json.loads(meta), arrays, crc)
    except ValueError as error:
        raise ConfigError(f"{name}: {error}: calibrate again") from None


def _from_content(name: str, meta: dict[str, Any], arrays: dict[str, Any], crc: int) -> Calibration:
    if meta.get("version") != VERSION:
        raise ConfigError(f"{name}: calibration version {meta.get('version')}, expected {VERSION}: calibrate again")
    if set(arrays) != set(_ARRAYS):
        raise ConfigError(f"{name}: not a calibration; expected a file written by `tacshade-edge calibrate`")
    height, width = arrays["reference_white"].shape
    return Calibration(
        geometry=Geometry(
            skin_radius_mm=meta["skin_radius_mm"],
            camera_distance_mm=meta["camera_distance_mm"],
            visible_half_angle_deg=meta["visible_half_angle_deg"],
            disc=Disc(meta["row_c"], meta["col_c"], meta["radius_px"]),
        ),
        polarity=meta["polarity"],
        binarisation=meta["binarisation"],
        image_height_px=height,
        image_width_px=width,
        pitch_px=meta["pitch_px"],
        noise_grey=meta["noise_grey"],
        alpha=meta["alpha"],
        fit=_fit(meta["fit"]),
        flange_T_sensor=tuple(meta["flange_T_sensor"]),
        crc32=crc,
        factors=meta["factors"],
        **arrays,
    )
