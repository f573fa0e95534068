"""The calibration as one ``.npz`` file: versioned, checksummed, written whole or not at all."""

from __future__ import annotations

import logging
import os
from dataclasses import replace
from pathlib import Path

from tacshade_edge.core.calibration.inputs import Inputs
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.quoting import shown
from tacshade_edge.storage import checked_npz
from tacshade_edge.storage.atomic_files import write_whole
from tacshade_edge.storage.calibration import calibration_content, calibration_inputs, fitted_networks, touch_models
from tacshade_edge.storage.checked_npz import Content
from tacshade_edge.types import Calibration, Disc, Fit, FittedNetwork, Geometry, ProfileFit, TouchModel

_log = logging.getLogger(__name__)

VERSION = 9
"""It also counts the networks, as factors fit the weights shipped with them (tests/inference/test_network.py)."""
OLDEST = 6
"""Oldest readable version; later ones differ only in the networks that their factors fit. Older factors are ignored."""
REFERENCE_ARRAYS = ("reference_white", "reference_grey")


def fit_figures(fit: Fit | None) -> dict[str, float]:
    """A fit under flat keys, as in the file and in the commands' JSON; a profile's keys begin with its name."""
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
    """The fit that `fit_figures` flattened."""
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
    """The scalars and arrays of a calibration."""
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
    if calibration.error_scales:  # older files have none and must keep their checksum
        meta["error_scales"] = dict(calibration.error_scales)
    arrays = {name: getattr(calibration, name) for name in REFERENCE_ARRAYS}
    for key, packed in (
        ("fitted", fitted_networks.pack(calibration.fitted)),
        ("touch", touch_models.pack(calibration.touch)),
    ):
        if packed[0]:
            meta, arrays = {**meta, key: packed[0]}, {**arrays, **packed[1]}
    return Content(meta, arrays)


def with_crc(calibration: Calibration) -> Calibration:
    """The same calibration with the checksum of its content."""
    return replace(calibration, crc32=_content(calibration).crc32)


def save(path: str | os.PathLike[str], calibration: Calibration, inputs: Inputs | None = None) -> Calibration:
    """Write a calibration; readers see the old file or the whole new one.

    Parameters
    ----------
    path : str
    calibration : Calibration
    inputs : Inputs, optional
        The calibration's source images, for `inputs_in`. If they are too large, a log line says so.

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
    content = _content(stored)
    if inputs is not None:
        if kept := calibration_inputs.pack(inputs):
            content = Content({**content.meta, "inputs": kept[0]}, {**content.arrays, **kept[1]})
        else:
            _log.warning("%s: the calibration's images are too large to store; calibrate again after each update", path)
    try:
        write_whole(Path(path), content.packed())
    except OSError as error:
        raise DeviceError(f"{path}: cannot write the calibration: {error.strerror or error}") from None
    return stored


def load(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration. An older version loads without factors and fit, and the log says so.

    Raises
    ------
    ConfigError
        The file is absent, not a calibration, of another version, damaged, or describes an impossible sensor.
    """
    name = os.fspath(path)
    content, _ = checked_npz.read(name, "calibration", "`tacshade-edge calibrate`")
    try:
        return _from_content(name, content)
    except ValueError as error:
        raise ConfigError(f"{name}: {shown(error)}; calibrate again") from None


def version_of(path: str | os.PathLike[str]) -> int | None:
    """A file's stated version; None if that is not an integer. Raises ConfigError like `inputs_in`."""
    content, _ = checked_npz.read(os.fspath(path), "calibration", "`tacshade-edge calibrate`")
    version = content.meta.get("version")
    return version if type(version) is int else None


def inputs_in(path: str | os.PathLike[str]) -> Inputs | None:
    """The inputs that a calibration of any version was made from; None if its file does not hold them.

    Raises
    ------
    ConfigError
        The file is absent, not a calibration, or damaged.
    """
    name = os.fspath(path)
    content, _ = checked_npz.read(name, "calibration", "`tacshade-edge calibrate`")
    if "inputs" not in content.meta:
        return None
    try:
        shape = content.arrays["reference_grey"].shape
        if len(shape) != 2:
            raise ValueError("expected an image in reference_grey")
        return calibration_inputs.unpack(content.meta["inputs"], content.arrays, shape)
    except (ValueError, KeyError) as error:
        raise ConfigError(f"{name}: cannot read the stored images: {shown(error)}; calibrate again") from None


def fitted_in(path: str | os.PathLike[str]) -> dict[str, FittedNetwork]:
    """The fitted networks of a calibration of any version. Raises ConfigError like `inputs_in`."""
    name = os.fspath(path)
    content, _ = checked_npz.read(name, "calibration", "`tacshade-edge calibrate`")
    try:
        return fitted_networks.unpack(content.meta.get("fitted", {}), content.arrays)
    except ValueError as error:
        raise ConfigError(f"{name}: {shown(error)}; calibrate again") from None


def touch_in(path: str | os.PathLike[str]) -> dict[str, TouchModel]:
    """The touch models of a calibration of any version. Raises ConfigError like `inputs_in`."""
    name = os.fspath(path)
    content, _ = checked_npz.read(name, "calibration", "`tacshade-edge calibrate`")
    try:
        return touch_models.unpack(content.meta.get("touch", {}), content.arrays)
    except ValueError as error:
        raise ConfigError(f"{name}: {shown(error)}; calibrate again") from None


def _from_content(name: str, content: Content) -> Calibration:
    meta, arrays = content.meta, content.arrays
    if meta.get("version") not in range(OLDEST, VERSION + 1):
        found = shown(meta.get("version"), 20)
        raise ConfigError(f"{name}: found calibration version {found}, expected {VERSION}; calibrate again")
    fitted = fitted_networks.unpack(meta.get("fitted", {}), arrays)
    touch = touch_models.unpack(meta.get("touch", {}), arrays)
    others = {*calibration_inputs.ARRAYS, *map(fitted_networks.array_name, fitted)}
    others.update(name for profile in touch for name in touch_models.array_names(profile))
    arrays = {key: array for key, array in arrays.items() if key not in others}
    if set(arrays) != set(REFERENCE_ARRAYS):
        raise ConfigError(f"{name}: not a calibration; expected a file written by `tacshade-edge calibrate`")
    calibration_content.check(content, REFERENCE_ARRAYS)
    height, width = arrays["reference_white"].shape
    if meta["version"] != VERSION and meta["factors"]:
        _log.warning("%s: ignoring the calibration's fit, which belongs to older networks; calibrate again", name)
        meta = {**meta, "factors": {}, "fit": {}, "error_scales": {}}
    calibration = Calibration(
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
        factors=meta["factors"],
        fitted=fitted,
        touch=touch,
        error_scales=meta.get("error_scales", {}),
        **arrays,
    )
    return with_crc(calibration)
