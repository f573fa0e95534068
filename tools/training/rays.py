"""`simulator.truth.skin_points`, compiled, because a training set needs a hundred thousand maps of points."""

from __future__ import annotations

import math

import numba
import numpy as np

from tacshade_edge.simulator.skin import Skin
from tacshade_edge.simulator.truth import pixel_rays
from tacshade_edge.types import F64, Geometry

MARCH_STEPS, REFINE_STEPS = 16, 8


def skin_points(skin: Skin, geometry: Geometry, row: F64, col: F64) -> F64:
    """Compute the same points as `simulator.truth.skin_points`."""
    origin, along = pixel_rays(geometry, row, col)
    points = np.empty_like(origin)
    least = skin.radius_mm - float(skin.height_mm.max())
    most = skin.radius_mm - min(float(skin.height_mm.min()), 0.0)
    _march(origin, along, skin.height_mm, skin.radius_mm, skin.step_mm, least, most, points)
    return points


@numba.njit(cache=True, fastmath=True, inline="always")
def _outside(x, y, z, height, radius, step):  # type: ignore[no-untyped-def]
    """The distance of a point outside the skin, along its radius."""
    n = height.shape[0] // 2
    length = math.sqrt(x * x + y * y + z * z)
    k = 2 * radius / (length + z) / step
    col, row = min(max(x * k + n, 0.0), 2.0 * n), min(max(y * k + n, 0.0), 2.0 * n)
    j, i = min(int(col), 2 * n - 1), min(int(row), 2 * n - 1)
    a, b = col - j, row - i
    top = height[i, j] * (1 - a) + height[i, j + 1] * a
    bottom = height[i + 1, j] * (1 - a) + height[i + 1, j + 1] * a
    return length - radius + top * (1 - b) + bottom * b


@numba.njit(cache=True, fastmath=True)
def _march(origin, along, height, radius, step, least, most, points):  # type: ignore[no-untyped-def]
    for k in range(len(origin)):
        ox, oy, oz = origin[k]
        ax, ay, az = along[k]
        foot = -(ox * ax + oy * ay + oz * az)
        off_axis = ox * ox + oy * oy + oz * oz - foot * foot
        low = foot + math.sqrt(max(least * least - off_axis, 0.0))
        end = foot + math.sqrt(max(most * most - off_axis, 0.0))
        start, each, high = low, (end - low) / MARCH_STEPS, low
        f_low, f_high = _outside(ox + low * ax, oy + low * ay, oz + low * az, height, radius, step), 0.0
        if f_low < 0:
            high = end
            for m in range(1, MARCH_STEPS + 1):
                s = start + m * each
                f = _outside(ox + s * ax, oy + s * ay, oz + s * az, height, radius, step)
                if f >= -1e-9:
                    high, f_high = s, max(f, 0.0)
                    break
                low, f_low = s, f
            for _ in range(REFINE_STEPS):
                gap = f_high - f_low
                if gap <= 1e-12 or high - low < 1e-7:
                    break
                s = (low * f_high - high * f_low) / gap
                f = _outside(ox + s * ax, oy + s * ay, oz + s * az, height, radius, step)
                if f >= 0:
                    high, f_high, f_low = s, f, f_low / 2
                else:
                    low, f_low, f_high = s, f, f_high / 2
        at_low = abs(_outside(ox + low * ax, oy + low * ay, oz + low * az, height, radius, step))
        at_high = abs(_outside(ox + high * ax, oy + high * ay, oz + high * az, height, radius, step))
        best = low if at_low < at_high else high
        points[k, 0], points[k, 1], points[k, 2] = ox + best * ax, oy + best * ay, oz + best * az
