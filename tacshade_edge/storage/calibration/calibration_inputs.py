"""A calibration's inputs inside its file: grey PNG images and the indenters' triangles, concatenated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import accumulate
from typing import Any, Final

import cv2
import msgspec
import numpy as np

from tacshade_edge.core.calibration.indenters import Indenter
from tacshade_edge.core.calibration.inputs import Inputs, KnownPress, Sensor
from tacshade_edge.core.image.image_bytes import decode_image
from tacshade_edge.errors import DecodeError
from tacshade_edge.storage.npz import parts_of, record_of
from tacshade_edge.types import U8

IMAGES, TRIANGLES = "input_images", "input_triangles"
ARRAYS = (IMAGES, TRIANGLES)
BYTES_MAX: Final = 48 << 20
"""Greatest total size of the images; larger ones are not stored."""
_ALWAYS = ("indenter", "yaw_deg", "tilt_x_deg", "tilt_y_deg")


class _Indenter(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    triangles: int


class _Inputs(msgspec.Struct, forbid_unknown_fields=True):
    """The lengths of the PNG files in order (references, renewed, presses), and everything that is not an array."""

    sensor: Sensor
    references: list[int]
    renewed: list[int]
    pressed: list[int]
    presses: list[dict[str, Any]]  # `KnownPress` with the number of its indenter
    indenters: list[_Indenter]


def pack(inputs: Inputs) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Pack inputs as values for JSON and the arrays `ARRAYS`; None if the images are too large to store."""
    groups = (inputs.references, inputs.renewed, tuple(press.image for press in inputs.presses))
    files = [[cv2.imencode(".png", image)[1].tobytes() for image in group] for group in groups]
    if sum(len(file) for group in files for file in group) > BYTES_MAX:
        return None
    indenters = list({id(p.indenter): p.indenter for p in inputs.presses if p.indenter is not None}.values())
    places = {id(indenter): k for k, indenter in enumerate(indenters)}
    lengths = [[len(file) for file in group] for group in files]
    meta = {
        "sensor": asdict(inputs.sensor),
        **dict(zip(("references", "renewed", "pressed"), lengths, strict=True)),
        "presses": [
            parts_of(replace(press, indenter=None), kept=_ALWAYS)[0] | {"indenter": places.get(id(press.indenter))}
            for press in inputs.presses
        ],
        "indenters": [{"name": each.name, "triangles": len(each.triangles_mm)} for each in indenters],
    }
    triangles = [each.triangles_mm for each in indenters] or [np.zeros((0, 3, 3))]
    images = np.frombuffer(b"".join(file for group in files for file in group), np.uint8)
    return meta, {IMAGES: images, TRIANGLES: np.concatenate(triangles)}


def unpack(meta: Mapping[str, Any], arrays: Mapping[str, Any]) -> Inputs | None:
    """The inputs in a calibration's content, with images of its reference's size; None without. Raises ValueError."""
    if "inputs" not in meta:
        return None
    try:
        shape = arrays["reference_grey"].shape
        if len(shape) != 2:
            raise ValueError("expected an image in reference_grey")
        return _inputs(msgspec.convert(meta["inputs"], _Inputs), arrays[IMAGES], arrays[TRIANGLES], shape)
    except (ValueError, KeyError) as error:
        raise ValueError(f"cannot read the stored images: {error}") from None


def _inputs(known: _Inputs, files: Any, solids: Any, shape: tuple[int, int]) -> Inputs:
    if len(known.pressed) != len(known.presses):
        raise ValueError("expected an image for each press")
    if files.dtype != np.uint8 or files.ndim != 1:
        raise ValueError(f"expected the bytes of images in {IMAGES}")
    if solids.dtype != np.float64 or solids.shape[1:] != (3, 3) or not np.isfinite(solids).all():
        raise ValueError(f"expected triangles in {TRIANGLES}")
    lengths = [*known.references, *known.renewed, *known.pressed]
    images = [_grey(part, shape) for part in _parts(files, lengths)]
    triangles = _parts(solids, [each.triangles for each in known.indenters])
    indenters = [Indenter(each.name, part) for each, part in zip(known.indenters, triangles, strict=True)]
    first, second = len(known.references), len(known.references) + len(known.renewed)
    presses = []
    for press, image in zip(known.presses, images[second:], strict=True):
        number = msgspec.convert(press.get("indenter"), int | None)
        if number is not None and not 0 <= number < len(indenters):
            raise ValueError("expected an indenter for each press")
        indenter = None if number is None else indenters[number]
        presses.append(replace(record_of(KnownPress, {**press, "image": image, "indenter": None}), indenter=indenter))
    return Inputs(known.sensor, tuple(images[:first]), tuple(presses), tuple(images[first:second]))


def _parts(array: Any, lengths: Sequence[int]) -> Iterator[Any]:
    if min(lengths, default=0) < 0 or sum(lengths) != len(array):
        raise ValueError("expected parts as long as they are said to be")
    return (array[end - length : end] for length, end in zip(lengths, accumulate(lengths), strict=True))


def _grey(file: U8, shape: tuple[int, int]) -> U8:
    expected = f"expected a grey PNG image of {shape[1]}x{shape[0]} px"
    try:
        image = decode_image(file.tobytes(), cv2.IMREAD_GRAYSCALE)
    except DecodeError as error:
        raise ValueError(f"{error}; {expected}") from None
    if image.shape != shape:
        raise ValueError(f"found {image.shape[1]}x{image.shape[0]} px, {expected}")
    return image
