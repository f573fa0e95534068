"""Fitted networks inside a calibration's file: one array per profile, its weights followed by its correction."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from tacshade_edge.types import F32, FittedNetwork


class _Fitted(msgspec.Struct, forbid_unknown_fields=True):
    layout: str
    correction: tuple[int, int, int]
    held_out: int
    error_mm: float
    shipped_error_mm: float
    error_scale: float | None = None


def array_name(profile: str) -> str:
    """The name of a profile's array."""
    return f"fitted_{profile}"


def pack(fitted: Mapping[str, FittedNetwork]) -> tuple[dict[str, Any], dict[str, F32]]:
    """Pack fitted networks as values for JSON and arrays."""
    meta = {
        name: {
            "layout": each.layout,
            "correction": list(each.correction.shape),
            "held_out": each.held_out,
            "error_mm": each.error_mm,
            "shipped_error_mm": each.shipped_error_mm,
            **({} if each.error_scale is None else {"error_scale": each.error_scale}),
        }
        for name, each in fitted.items()
    }
    arrays = {
        array_name(name): np.concatenate((each.weights, each.correction.ravel()), dtype=np.float32)
        for name, each in fitted.items()
    }
    return meta, arrays


def unpack(meta: Mapping[str, Any], arrays: Mapping[str, Any]) -> dict[str, FittedNetwork]:
    """Unpack what `pack` returned.

    Raises
    ------
    ValueError
        `pack` did not make it.
    """
    known = msgspec.convert(meta, dict[str, _Fitted])
    return {name: _fitted(each, arrays.get(array_name(name))) for name, each in known.items()}


def _fitted(known: _Fitted, stored: F32 | None) -> FittedNetwork:
    size = math.prod(known.correction)
    if stored is None or stored.dtype != np.float32 or stored.ndim != 1 or not 0 < size < len(stored):
        raise ValueError("expected fitted weights as many as they are said to be")
    weights, correction = stored[:-size], stored[-size:].reshape(known.correction)
    return FittedNetwork(
        known.layout, weights, correction, known.held_out, known.error_mm, known.shipped_error_mm, known.error_scale
    )
