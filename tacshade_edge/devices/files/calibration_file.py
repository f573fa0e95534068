"""The calibration as one ``.npz``: versioned, checksummed, written whole or not at all."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from tacshade_edge.devices.files import checked_npz
from tacshade_edge.devices.files.checked_npz import Content
from tacshade_edge.devices.files.whole_files import write_whole
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.types import Calibration, Disc, Fit, Geometry, ProfileFit

VERSION = 6
"""Also of the networks: factors are fitted to the weights shipped then (tests/devices/weights/test_network.py)."""
REFERENCE_ARRAYS = ("reference_white", "reference_grey")


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


def _content(calibration: Calibration) -> Content:
    """Its scalars and its arrays."""
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
    return Content(meta, {name: getattr(calibration, name) for name in REFERENCE_ARRAYS})


def with_crc(calibration: Calibration) -> Calibration:
    """The same calibration with the checksum of its content."""
    return replace(calibration, crc32=_content(calibration).crc32)


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
    try:
        write_whole(Path(path), _content(stored).packed())
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
    content, crc = checked_npz.read(name, "calibration", "`tacshade-edge calibrate`")
    try:
        return _from_content(name, content, crc)
    except ValueError as error:
        raise ConfigError(f"{name}: {error}: calibrate again") from None


def _from_content(name: str, content: Content, crc: int) -> Calibration:
    meta, arrays = content.meta, content.arrays
    if meta.get("version") != VERSION:
        raise ConfigError(f"{name}: calibration version {meta.get('version')}, expected {VERSION}: calibrate again")
    if set(arrays) != set(REFERENCE_ARRAYS):
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
