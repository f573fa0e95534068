"""A patch of skin that an object holds, as one finger reports it in the hand's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.types import F64

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Patch:
    """One contact of one finger; vectors along the hand's axes.

    Attributes
    ----------
    place_mm : 3 floats
        Mean place of its points.
    normal : 3 floats
        Unit normal, from the finger into the object.
    axis : 3 floats
        The finger's z axis: shear is perpendicular to it, and twist is about it.
    shear_mm : 3 floats
        Mean shear of its skin.
    depth_mm : float
        Greatest h.
    twist_deg : float or None
        None if the contact is too small.
    slips : bool
        Whether the object slides over it.
    """

    place_mm: Triple
    normal: Triple
    axis: Triple
    shear_mm: Triple
    depth_mm: float
    twist_deg: float | None
    slips: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Several patches as arrays, one row each: `place_mm`, `normal`, `axis`, `shear_mm` (n, 3), the others (n,).

    Attributes
    ----------
    twist_rad : float64 (n,)
        NaN if unknown.
    """

    place_mm: F64
    normal: F64
    axis: F64
    shear_mm: F64
    depth_mm: F64
    twist_rad: F64


def stack(patches: Sequence[Patch]) -> Patches:
    """Convert patches to arrays."""
    rows = np.array(
        [
            (*p.place_mm, *p.normal, *p.axis, *p.shear_mm, p.depth_mm, np.nan if p.twist_deg is None else p.twist_deg)
            for p in patches
        ],
        np.float64,
    ).reshape(len(patches), 14)
    return Patches(rows[:, :3], rows[:, 3:6], rows[:, 6:9], rows[:, 9:12], rows[:, 12], np.radians(rows[:, 13]))
