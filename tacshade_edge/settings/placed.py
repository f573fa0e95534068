"""A position and orientation as people write them in settings: ``[x_mm, y_mm, z_mm, qw, qx, qy, qz]``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final

from msgspec import Meta

Placed = Annotated[list[float], Meta(min_length=7, max_length=7, description="x_mm, y_mm, z_mm, qw, qx, qy, qz")]

_UNIT_TOLERANCE: Final = 1e-3
_PLACE_MAX_MM: Final = 1e6


def wrong_with(seven: Sequence[float]) -> str | None:
    """The mistake in seven numbers that their type cannot find, ``found …, expected …``; None if there is none."""
    away_mm = max(abs(value) for value in seven[:3])
    if away_mm > _PLACE_MAX_MM:
        return f"found a place {away_mm:g} mm away, expected one within {_PLACE_MAX_MM:g}"
    norm = math.sqrt(sum(q * q for q in seven[3:]))
    if abs(norm - 1) > _UNIT_TOLERANCE:
        return f"found a quaternion of length {norm:.4g}, expected length 1"
    return None
