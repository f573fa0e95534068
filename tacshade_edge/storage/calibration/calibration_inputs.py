"""A calibration's inputs inside its file: grey PNG images and the indenters' triangles, concatenated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import accumulate
from typing import Any, Final

import cv2
import msgspec
import numpy as np

from tacshade_edge.core.calibration.indenters import Indenter
from tacshade_edge.core.calibration.inputs import Inputs, KnownPress, Sensor
from tacshade_edge.core.image.image_bytes import decode_image
from tacshade_edge.errors import DecodeError
from tacshade_edge.types import U8

IMAGES, TRIANGLES = "input_images", "input_triangles"
ARRAYS = (IMAGES, TRIANGLES)
BYTES_MAX: Final = 48 << 20
"""Greatest total size of the images; larger ones are not stored."""


class _Press(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    radius_mm: float
    depth_mm: float
    x_mm: float | None
    y_mm: float | None
    indenter: int | None
    yaw_deg: float
    tilt_x_deg: float
    tilt_y_deg: float


class _Indenter(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    triangles: int


class _Inputs(msgspec.Struct, forbid_unknown_fields=True):
    """The lengths of the PNG files in order (references, renewed, presses), and everything that is not an array."""

    sensor: Sensor
    references: list[int]
    renewed: list[int]
    pressed: list[int]
    presses: list[_Press]
    indenters: list[_Indenter]


def pack(inputs: Inputs) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Pack inputs as values for JSON and the arrays `ARRAYS`; None if the images are too large to store."""
    groups = (inputs.references, inputs.renewed, tuple(press.image for press in inputs.presses))
    files = [[_png(image) for image in group] for group in groups]
    if sum(len(file) for group in files for file in group) > BYTES_MAX:
        return None
    indenters = list({id(p.indenter): p.indenter for p in inputs.presses if p.indenter is not None}.values())
    places = {id(indenter): k for k, indenter in enumerate(indenters)}
    kept = ("name", "radius_mm", "depth_mm", "x_mm", "y_mm", "yaw_deg", "tilt_x_deg", "tilt_y_deg")
    meta = {
        "sensor": asdict(inputs.sensor),
        **{
            name: [len(file) for file in group]
            for name, group in zip(("references", "renewed", "pressed"), files, strict=True)
        },
        "presses": [
            {name: getattr(press, name) for name in kept}
            | {"indenter": None if press.indenter is None else places[id(press.indenter)]}
            for press in inputs.presses
        ],
        "indenters": [{"name": each.name, "triangles": len(each.triangles_mm)} for each in indenters],
    }
    triangles = [each.triangles_mm for each in indenters] or [np.zeros((0, 3, 3))]
    images = np.frombuffer(b"".join(file for group in files for file in group), np.uint8)
    return meta, {IMAGES: images, TRIANGLES: np.concatenate(triangles)}


def unpack(meta: Mapping[str, Any], arrays: Mapping[str, Any], shape: tuple[int, int]) -> Inputs:
    """Unpack what `pack` returned, with images of `shape`.

    Raises
    ------
    ValueError
        `pack` did not make it.
    """
    known = msgspec.convert(meta, _Inputs)
    if len(known.pressed) != len(known.presses):
        raise ValueError("expected an image for each press")
    files, solids = arrays[IMAGES], arrays[TRIANGLES]
    if files.dtype != np.uint8 or files.ndim != 1:
        raise ValueError(f"expected the bytes of images in {IMAGES}")
    if solids.dtype != np.float64 or solids.shape[1:] != (3, 3) or not np.isfinite(solids).all():
        raise ValueError(f"expected triangles in {TRIANGLES}")
    lengths = [*known.references, *known.renewed, *known.pressed]
    images = [_grey(part, shape) for part in _parts(files, lengths)]
    triangles = _parts(solids, [each.triangles for each in known.indenters])
    indenters = [Indenter(each.name, part) for each, part in zip(known.indenters, triangles, strict=True)]
    first, second = len(known.references), len(known.references) + len(known.renewed)
    if any(p.indenter is not None and not 0 <= p.indenter < len(indenters) for p in known.presses):
        raise ValueError("expected an indenter for each press")
    return Inputs(
        known.sensor,
        tuple(images[:first]),
        tuple(_press(p, image, indenters) for p, image in zip(known.presses, images[second:], strict=True)),
        tuple(images[first:second]),
    )


def _press(press: _Press, image: U8, indenters: Sequence[Indenter]) -> KnownPress:
    known = msgspec.structs.asdict(press)
    number = known.pop("indenter")
    return KnownPress(image=image, indenter=None if number is None else indenters[number], **known)


def _parts(array: Any, lengths: Sequence[int]) -> Iterator[Any]:
    if min(lengths, default=0) < 0 or sum(lengths) != len(array):
        raise ValueError("expected parts as long as they are said to be")
    return (array[end - length : end] for length, end in zip(lengths, accumulate(lengths), strict=True))


def _png(image: U8) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def _grey(file: U8, shape: tuple[int, int]) -> U8:
    expected = f"expected a grey PNG image of {shape[1]}x{shape[0]} px"
    try:
        image = decode_image(file.tobytes(), cv2.IMREAD_GRAYSCALE)
    except DecodeError as error:
        raise ValueError(f"{error}; {expected}") from None
    if image.shape != shape:
        raise ValueError(f"found {image.shape[1]}x{image.shape[0]} px, {expected}")
    return image
