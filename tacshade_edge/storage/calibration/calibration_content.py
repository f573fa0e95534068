"""Checks a calibration file's content: a matching checksum does not prove that the content is a calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from tacshade_edge.rigid import from_seven
from tacshade_edge.storage.checked_npz import Content
from tacshade_edge.types import Binarisation, Polarity

_MOST = 1e6
# `Calibration` checks most ranges itself; the types here bound the rest.
_Bounded = Annotated[float, Meta(ge=-_MOST, le=_MOST)]


class _Scalars(msgspec.Struct, frozen=True):
    skin_radius_mm: float
    camera_distance_mm: float | None
    visible_half_angle_deg: float
    row_c: float
    col_c: float
    radius_px: float
    polarity: Polarity
    binarisation: Binarisation
    pitch_px: float
    noise_grey: float
    alpha: float
    factors: dict[str, float]
    fit: dict[str, Annotated[float, Meta(ge=0, le=_MOST)]]
    flange_T_sensor: tuple[_Bounded, _Bounded, _Bounded, _Bounded, _Bounded, _Bounded, _Bounded]
    error_scales: dict[str, float] = {}


def check(content: Content, references: tuple[str, ...]) -> None:
    """Refuse content that is not a calibration.

    Parameters
    ----------
    content : Content
    references : tuple of str
        Names of the arrays that must be images of one size.

    Raises
    ------
    ValueError
        A value is missing, of the wrong type or out of range; the text names it.
    """
    scalars = msgspec.convert(content.meta, _Scalars)
    numbers = (*scalars.flange_T_sensor, *scalars.fit.values())
    if not all(map(math.isfinite, numbers)):  # NaN passes every range
        raise ValueError("found a number that is not finite in fit or flange_T_sensor")
    _check_fit(scalars.fit)
    from_seven(scalars.flange_T_sensor)
    images = [content.arrays[name] for name in references]
    if any(image.dtype != np.uint8 or image.ndim != 2 or not image.size for image in images):
        raise ValueError(f"found other arrays, expected images of uint8 in {', '.join(references)}")
    if len({image.shape for image in images}) > 1:
        raise ValueError(f"found several sizes, expected one of {', '.join(references)}")


def _check_fit(fit: Mapping[str, Any]) -> None:
    """Refuse a fit with some figures missing; an empty one is no fit."""
    suffix = "_depth_mae_mm"
    profiles = [key.removesuffix(suffix) for key in fit if key.endswith(suffix)]
    keys = {"presses", "agreement_mae_mm", "position_mae_mm"}
    for name in profiles:
        keys |= {f"{name}_presses", f"{name}{suffix}", f"{name}_depth_worst_mm"}
    if fit and (missing := keys - set(fit)):
        raise ValueError(f"fit: found no {', '.join(sorted(missing))}")
