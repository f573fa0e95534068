"""A patch of skin that an object holds, as one finger reports it in the hand's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.types import F64

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Patch:
    """One contact of one finger; vectors along the hand's axes: mean place, unit normal into the object, the finger's z
    axis (shear is perpendicular to it, twist about it, None if the contact is too small), mean shear, greatest h.
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
    """Several patches as arrays, one row each: `place_mm`, `normal`, `axis`, `shear_mm` (n, 3), the others (n,); an
    unknown twist is NaN.
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
