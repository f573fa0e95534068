"""Touch models inside a calibration's file: for each profile 16-bit components, and all other numbers in 32 bits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from tacshade_edge.types import QUANTITIES, TOUCH_ARRAYS, TouchModel

MAX_BYTES = 4 << 20
_OTHERS = tuple(name for name in TOUCH_ARRAYS if name != "components")


class _Model(msgspec.Struct, forbid_unknown_fields=True):
    names: tuple[str, ...]
    networks: str
    shapes: dict[str, list[int]]
    scale: float
    width: float
    leverage_max: float
    residual_max: float
    imprint_max: float


_NUMBERS = ("scale", "width", "leverage_max", "residual_max", "imprint_max")


def array_names(profile: str) -> tuple[str, str]:
    """The names of a profile's two arrays."""
    return f"touch_{profile}", f"touch_{profile}_components"


def pack(models: Mapping[str, TouchModel]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Pack touch models as values for JSON and arrays."""
    meta, arrays = {}, {}
    for profile, model in models.items():
        meta[profile] = {
            "names": list(model.names),
            "networks": model.networks,
            "shapes": {name: list(getattr(model, name).shape) for name in TOUCH_ARRAYS},
            **{name: getattr(model, name) for name in _NUMBERS},
        }
        numbers, components = array_names(profile)
        arrays[numbers] = np.concatenate([getattr(model, name).ravel() for name in _OTHERS], dtype=np.float32)
        arrays[components] = model.components.astype(np.float16)
    return meta, arrays


def unpack(meta: Mapping[str, Any], arrays: Mapping[str, Any]) -> dict[str, TouchModel]:
    """Unpack what `pack` returned.

    Raises
    ------
    ValueError
        `pack` did not make it.
    """
    known = msgspec.convert(meta, dict[str, _Model])
    return {
        profile: _model(each, *(arrays.get(name) for name in array_names(profile))) for profile, each in known.items()
    }


def _model(known: _Model, numbers: Any, components: Any) -> TouchModel:
    if set(known.shapes) != set(TOUCH_ARRAYS) or not set(known.names) <= set(QUANTITIES):
        raise ValueError("touch model: found other arrays or quantities than expected")
    sizes = [math.prod(known.shapes[name]) for name in _OTHERS]
    stored = (numbers, np.float32, [sum(sizes)]), (components, np.float16, known.shapes["components"])
    if any(array is None or array.dtype != kind or list(array.shape) != shape for array, kind, shape in stored):
        raise ValueError("touch model: expected arrays as large as they are said to be")
    if numbers.nbytes + components.nbytes > MAX_BYTES:
        raise ValueError(f"touch model: more than {MAX_BYTES >> 20} MB")
    parts = np.split(numbers, np.cumsum(sizes)[:-1])
    values: dict[str, Any] = {name: getattr(known, name) for name in _NUMBERS}
    for name, part in zip(_OTHERS, parts, strict=True):
        values[name] = part.reshape(known.shapes[name])
    return TouchModel(names=known.names, networks=known.networks, components=components.astype(np.float32), **values)
