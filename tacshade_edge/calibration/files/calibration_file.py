"""The calibration as one ``.npz`` file: versioned, checksummed, written whole or not at all."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, asdict, fields, replace
from itertools import accumulate
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

import cv2
import msgspec
import numpy as np
from msgspec import Meta

from tacshade_edge.calibration.indenters import Indenter
from tacshade_edge.calibration.inputs import Inputs, KnownPress, StatedSensor
from tacshade_edge.errors import ConfigError, DecodeError, DeviceError
from tacshade_edge.files import npz
from tacshade_edge.files.atomic_files import write_whole
from tacshade_edge.files.image_bytes import decode_image
from tacshade_edge.files.npz import Content, parts_of, record_of
from tacshade_edge.quoting import shown
from tacshade_edge.rigid import from_seven
from tacshade_edge.types import (
    QUANTITIES,
    TOUCH_ARRAYS,
    U8,
    Calibration,
    Fit,
    FittedNetwork,
    ProfileFit,
    TouchModel,
)

_log = logging.getLogger(__name__)
T = TypeVar("T")

VERSION = 9
"""It also counts the networks, as factors fit the weights shipped with them
(tests/sensor/inference/test_network.py).
"""
OLDEST = 6
"""Oldest readable version; later ones differ only in the networks that their factors fit.

Older factors are ignored.
"""
REFERENCE_ARRAYS = ("reference_white", "reference_grey")
TOUCH_BYTES_MAX = 4 << 20
_IMAGE_AXES = 2  # a grey image has rows and columns, nothing else
_ALWAYS = ("factors", "fit", "flange_T_sensor")
_Shape = list[Annotated[int, Meta(ge=0)]]


def fit_figures(fit: Fit | None) -> dict[str, float]:
    """A fit under flat keys, as in the file and in the commands' JSON;
    a profile's keys begin with its name.
    """
    if fit is None:
        return {}
    figures = _figures(fit)
    for name, profile in fit.profiles.items():
        figures |= {f"{name}_{part}": value for part, value in _figures(profile).items()}
    return figures


def _figures(fit: Fit | ProfileFit) -> dict[str, float]:
    # Not those at their default: a file from before they existed keeps its checksum.
    numbers = {each.name: each.default for each in fields(fit) if each.name != "profiles"}
    found = {name: getattr(fit, name) for name in numbers}
    return {name: float(value) for name, value in found.items() if value != numbers[name]}


def _fit(figures: Any) -> Fit | None:
    """The fit that `fit_figures` flattened. Raises ValueError."""
    given = msgspec.convert(figures, dict[str, Annotated[float, Meta(ge=0, le=1e6)]])
    if not given:
        return None
    suffix = "_depth_mae_mm"
    names = [key.removesuffix(suffix) for key in given if key.endswith(suffix)]
    profiles = {name: ProfileFit(**_known(ProfileFit, given, f"{name}_")) for name in names}
    return Fit(**_known(Fit, given), profiles=profiles)


def _known(kind: type, given: Mapping[str, float], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for each in fields(kind):
        if (key := prefix + each.name) in given:
            found[each.name] = int(given[key]) if each.name == "presses" else given[key]
        elif each.default is MISSING and each.default_factory is MISSING:
            raise ValueError(f"fit: found no '{key}'")
    return found


def _content(calibration: Calibration) -> Content:
    meta, arrays = parts_of(
        replace(calibration, fit=None, fitted={}, touch={}, rest={}, known={}, crc32=0),
        kept=_ALWAYS,
    )
    del meta["image_height_px"], meta["image_width_px"]  # as the images'
    meta |= {"version": VERSION, "fit": fit_figures(calibration.fit)}
    if calibration.rest:
        meta["rest"] = {name: asdict(limits) for name, limits in calibration.rest.items()}
    for name, fitted in calibration.fitted.items():
        meta.setdefault("fitted", {})[name], parts = parts_of(fitted)
        arrays[f"fitted_{name}"] = parts["weights"]
    for name, model in calibration.touch.items():
        about, parts = parts_of(model)
        about["shapes"] = {key: list(part.shape) for key, part in parts.items()}
        meta.setdefault("touch", {})[name] = about
        components = parts.pop("components").astype(np.float16)
        arrays[f"touch_{name}"] = np.concatenate(
            [part.ravel() for part in parts.values()], dtype=np.float32
        )
        arrays[f"touch_{name}_components"] = components
    return Content(meta, arrays)


def with_crc(calibration: Calibration) -> Calibration:
    """The same calibration with the checksum of its content."""
    return replace(calibration, crc32=_content(calibration).crc32)


def save(
    path: str | os.PathLike[str], calibration: Calibration, inputs: Inputs | None = None
) -> Calibration:
    """Write a calibration whole, and its source images (the log says if they are too large) for
    `inputs_in`; return it with its `crc32`.

    Raises DeviceError.
    """
    stored = with_crc(calibration)
    content, data = _content(stored), b""
    if inputs is not None:
        if kept := pack_inputs(inputs):
            arrays = {**content.arrays, **kept[1]}
            data = Content({**content.meta, "inputs": kept[0]}, arrays).packed()
        # Beside large references or solids, even those that are not too many.
        if not (data and npz.is_read(data)):
            why = (
                "the calibration's images are too large to store; calibrate again after each update"
            )
            _log.warning("%s: %s", path, why)
            data = b""
    try:
        write_whole(Path(path), data or content.packed())
    except OSError as error:
        raise DeviceError(
            f"{path}: cannot write the calibration: {error.strerror or error}"
        ) from None
    return stored


def packed(calibration: Calibration) -> bytes:
    """A calibration's file, without source images."""
    return _content(with_crc(calibration)).packed()


def load(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration; an older version loads without factors and fit, and the log says so.

    Raises ConfigError, as do the functions below, which read files of any version.
    """
    return _read(path, lambda content: _calibration(path, content))


def version_of(path: str | os.PathLike[str]) -> int | None:
    """A file's stated version; None if that is not an integer."""
    version = _read(path, lambda content: content.meta.get("version"))
    return version if type(version) is int else None


def inputs_in(path: str | os.PathLike[str]) -> Inputs | None:
    """The inputs that a calibration was made from; None if its file does not hold them."""
    return _read(path, lambda content: unpack_inputs(content.meta, content.arrays))


def fitted_in(path: str | os.PathLike[str]) -> dict[str, FittedNetwork]:
    """The fitted networks of a calibration."""
    return _read(path, _fitted)


def touch_in(path: str | os.PathLike[str]) -> dict[str, TouchModel]:
    """The touch models of a calibration."""
    return _read(path, _touch)


def _read(path: str | os.PathLike[str], unpack: Callable[[Content], T]) -> T:
    content = npz.read(os.fspath(path), "calibration", "`tacshade-edge calibrate`")
    try:
        return unpack(content)
    except ValueError as error:
        raise ConfigError(f"{os.fspath(path)}: {shown(error)}; calibrate again") from None


def _calibration(path: str | os.PathLike[str], content: Content) -> Calibration:
    meta, arrays = dict(content.meta), content.arrays
    if (version := meta.get("version")) not in range(OLDEST, VERSION + 1):
        raise ValueError(f"found calibration version {shown(version, 20)}, expected {VERSION}")
    if missing := [name for name in _ALWAYS if name not in meta]:
        raise ValueError(f"found no {missing[0]}")
    if version != VERSION and meta["factors"]:
        _log.warning(
            "%s: ignoring the calibration's fit, which belongs to older networks; calibrate again",
            path,
        )
        meta |= {"factors": {}, "fit": {}, "error_scales": {}}
    if version != VERSION:
        meta.pop("rest", None)  # of other networks
    shapes = {array.shape for name, array in arrays.items() if name in REFERENCE_ARRAYS}
    if len(shapes) != 1 or len(shape := shapes.pop()) != _IMAGE_AXES or 0 in shape:
        raise ValueError(
            f"found other arrays, expected images of one size in {', '.join(REFERENCE_ARRAYS)}"
        )
    known = {
        **{name: array for name, array in arrays.items() if name in REFERENCE_ARRAYS},
        **{"image_height_px": shape[0], "image_width_px": shape[1]},
        **{"fit": _fit(meta["fit"]), "fitted": _fitted(content), "touch": _touch(content)},
    }
    calibration = record_of(Calibration, meta | known, strict=False)
    # It raises ValueError for numbers that are no pose; what it returns is not needed here.
    from_seven(calibration.flange_T_sensor)
    return with_crc(calibration)


def _fitted(content: Content) -> dict[str, FittedNetwork]:
    """The networks, of each of which an array holds the weights. Raises ValueError."""
    made = {}
    for name, about in _profiles(content, "fitted").items():
        weights = content.arrays.get(f"fitted_{name}")
        if weights is None or weights.ndim != 1 or not len(weights):
            raise ValueError("found no fitted weights")
        made[name] = record_of(FittedNetwork, about | {"weights": weights})
    return made


def _touch(content: Content) -> dict[str, TouchModel]:
    """The models, of each of which an array holds all parts but the components,
    which are in 16 bits.
    """
    made = {}
    for name, about in _profiles(content, "touch").items():
        shapes = msgspec.convert(about.pop("shapes", None), dict[str, _Shape])
        if set(shapes) | {"metric", "origin"} != set(TOUCH_ARRAYS):
            raise ValueError("touch model: found other arrays than expected")
        own = np.eye(
            shapes["components"][-1], dtype=np.float32
        )  # of a model learnt before there was one
        about = {"origin": 0 * own[0], "metric": own, "gate_part": 1.0} | about
        others = [key for key in TOUCH_ARRAYS if key != "components" and key in shapes]
        sizes = [math.prod(shapes[key]) for key in others]
        numbers, components = (
            content.arrays.get(f"touch_{name}{end}", np.zeros(0)) for end in ("", "_components")
        )
        stored = (numbers, np.float32, [sum(sizes)]), (components, np.float16, shapes["components"])
        if any(array.dtype != kind or list(array.shape) != shape for array, kind, shape in stored):
            raise ValueError("touch model: expected arrays as large as they are said to be")
        # A damaged or hostile file must not fill a small board's memory.
        if numbers.nbytes + components.nbytes > TOUCH_BYTES_MAX:
            raise ValueError(f"touch model: more than {TOUCH_BYTES_MAX >> 20} MB")
        parts = zip(others, np.split(numbers, np.cumsum(sizes)[:-1]), strict=True)
        about |= {key: part.reshape(shapes[key]) for key, part in parts}
        model = record_of(TouchModel, about | {"components": components.astype(np.float32)})
        if not set(model.names) <= set(QUANTITIES):
            raise ValueError("touch model: found other quantities than expected")
        made[name] = model
    return made


def _profiles(content: Content, key: str) -> dict[str, dict[str, Any]]:
    """What the file says of each profile under `key`."""
    return msgspec.convert(content.meta.get(key, {}), dict[str, dict[str, Any]])


IMAGES, TRIANGLES = "input_images", "input_triangles"
INPUT_ARRAYS = (IMAGES, TRIANGLES)
_SIZED = "reference_grey"  # of the images' size
INPUT_BYTES_MAX: Final = 48 << 20
"""Greatest total size of the images; larger ones are not stored."""
_OF_PRESSES = ("indenter", "yaw_deg", "tilt_x_deg", "tilt_y_deg")


class _Indenter(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    triangles: int


class _Inputs(msgspec.Struct, forbid_unknown_fields=True):
    """The lengths of the PNG files in order (references, renewed, presses),
    and everything that is not an array.
    """

    sensor: StatedSensor
    references: list[int]
    renewed: list[int]
    pressed: list[int]
    presses: list[dict[str, Any]]  # `KnownPress` with the number of its indenter
    indenters: list[_Indenter]


def pack_inputs(inputs: Inputs) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Pack inputs as values for JSON and the arrays `INPUT_ARRAYS`;
    None if the images are too large to store.
    """
    groups = (inputs.references, inputs.renewed, tuple(press.image for press in inputs.presses))
    files = [[cv2.imencode(".png", image)[1].tobytes() for image in group] for group in groups]
    if sum(len(file) for group in files for file in group) > INPUT_BYTES_MAX:
        return None
    # By identity: forty presses share a mesh of many triangles.
    indenters = list(
        {id(p.indenter): p.indenter for p in inputs.presses if p.indenter is not None}.values()
    )
    places = {id(indenter): k for k, indenter in enumerate(indenters)}
    lengths = [[len(file) for file in group] for group in files]
    meta = {
        "sensor": asdict(inputs.sensor),
        **dict(zip(("references", "renewed", "pressed"), lengths, strict=True)),
        "presses": [
            parts_of(replace(press, indenter=None), kept=_OF_PRESSES)[0]
            | {"indenter": places.get(id(press.indenter))}
            for press in inputs.presses
        ],
        "indenters": [
            {"name": each.name, "triangles": len(each.triangles_mm)} for each in indenters
        ],
    }
    triangles = [each.triangles_mm for each in indenters] or [np.zeros((0, 3, 3))]
    images = np.frombuffer(b"".join(file for group in files for file in group), np.uint8)
    return meta, {IMAGES: images, TRIANGLES: np.concatenate(triangles)}


def unpack_inputs(meta: Mapping[str, Any], arrays: Mapping[str, Any]) -> Inputs | None:
    """The inputs in a calibration's content, with images of its reference's size; None without.

    Raises ValueError.
    """
    if "inputs" not in meta:
        return None
    try:
        known = msgspec.convert(meta["inputs"], _Inputs)
        files, solids = [arrays[name] for name in INPUT_ARRAYS]
        return _inputs(known, files, solids, reference=arrays[_SIZED])
    except (ValueError, KeyError) as error:
        raise ValueError(f"cannot read the stored images: {error}") from None


def _inputs(known: _Inputs, files: Any, solids: Any, reference: Any) -> Inputs:
    expected = {
        f"an image in {_SIZED}": reference.ndim == _IMAGE_AXES,
        "an image for each press": len(known.pressed) == len(known.presses),
        f"the bytes of images in {IMAGES}": files.dtype == np.uint8 and files.ndim == 1,
        f"triangles in {TRIANGLES}": solids.dtype == np.float64
        and solids.shape[1:] == (3, 3)
        and np.isfinite(solids).all(),
    }
    if missing := next((what for what, is_there in expected.items() if not is_there), ""):
        raise ValueError(f"expected {missing}")
    lengths = [*known.references, *known.renewed, *known.pressed]
    images = [_grey(part, reference.shape) for part in _parts(files, lengths)]
    triangles = _parts(solids, [each.triangles for each in known.indenters])
    indenters = [
        Indenter(each.name, part) for each, part in zip(known.indenters, triangles, strict=True)
    ]
    first, second = len(known.references), len(known.references) + len(known.renewed)
    presses = []
    for press, image in zip(known.presses, images[second:], strict=True):
        number = msgspec.convert(press.get("indenter"), int | None)
        if number is not None and not 0 <= number < len(indenters):
            raise ValueError("expected an indenter for each press")
        indenter = None if number is None else indenters[number]
        presses.append(
            replace(
                record_of(KnownPress, {**press, "image": image, "indenter": None}),
                indenter=indenter,
            )
        )
    return Inputs(known.sensor, tuple(images[:first]), tuple(presses), tuple(images[first:second]))


def _parts(array: Any, lengths: Sequence[int]) -> Iterator[Any]:
    if min(lengths, default=0) < 0 or sum(lengths) != len(array):
        raise ValueError("expected parts as long as they are said to be")
    return (
        array[end - length : end] for length, end in zip(lengths, accumulate(lengths), strict=True)
    )


def _grey(file: U8, shape: tuple[int, int]) -> U8:
    expected = f"expected a grey PNG image of {shape[1]}x{shape[0]} px"
    try:
        image = decode_image(file.tobytes(), cv2.IMREAD_GRAYSCALE)
    except DecodeError as error:
        raise ValueError(f"{error}; {expected}") from None
    if image.shape != shape:
        raise ValueError(f"found {image.shape[1]}x{image.shape[0]} px, {expected}")
    return image
