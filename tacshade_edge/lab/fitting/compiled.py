"""Parts of the simulator, compiled: a twin needs thousands of skins and pictures.

The membrane (`lab.simulator.skin.solve`, `slid`), what pixels see
(`lab.simulator.truth.skin_points`), and how material points move (`lab.simulator.render.carried`,
`lab.simulator.truth.shear_mm`).
"""

from __future__ import annotations

import math

import numba
import numpy as np

from tacshade_edge.lab.simulator import drag
from tacshade_edge.lab.simulator import skin as uncompiled
from tacshade_edge.lab.simulator.drag import Contacts
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import Skin, chart_to_direction, direction_to_chart
from tacshade_edge.lab.simulator.truth import pixel_rays
from tacshade_edge.types import F32, F64, Geometry

# As in `lab.simulator.truth`.
MARCH_STEPS, REFINE_STEPS = 16, 8
DRAG_STEPS, DRAG_TOLERANCE_MM = 40, 2e-3
INVERSE_STEPS, INVERSE_TOLERANCE_MM = 60, 1e-3
# Looser than the simulator's 1e-4, as a twin needs thousands of skins. A test holds the two against
# each other within 5 µm.
TOLERANCE_MM = 5e-4
SWEEPS = 600
RELAXATION, SLID_TOLERANCE_MM = 1.7, 1e-3


def solve(obstacle: F32, mass: F32) -> F32:
    """Solve like `lab.simulator.skin.solve`, within `TOLERANCE_MM`."""
    height = obstacle.copy()
    if min(obstacle.shape) >= 24:
        coarse = solve(
            np.ascontiguousarray(obstacle[::2, ::2]), np.ascontiguousarray(mass[::2, ::2]) * 4
        )
        _refine(coarse, height)
    height[0] = height[-1] = 0
    height[:, 0] = height[:, -1] = 0
    # Stiffness varies, and the least stiffness would over-relax all other nodes.
    jacobi = 4 / (4 + float(np.median(mass)))
    omega = 2 / (1 + math.sqrt(1 - jacobi * jacobi))
    _relax(
        height, obstacle, 1 / (4 + mass), np.float32(omega), np.float32(TOLERANCE_MM * (2 - omega))
    )
    return height


@numba.njit(cache=True, fastmath=True)
# Not cv2.warpAffine: the obstacle is applied on the way, without another array.
def _refine(coarse, fine):  # type: ignore[no-untyped-def]
    """Raise `fine` to the coarse grid's values between its nodes."""
    for i in range(fine.shape[0]):
        for j in range(fine.shape[1]):
            a, b = i // 2, j // 2
            c, d = min(a + i % 2, coarse.shape[0] - 1), min(b + j % 2, coarse.shape[1] - 1)
            value = (coarse[a, b] + coarse[c, b] + coarse[a, d] + coarse[c, d]) * np.float32(0.25)
            fine[i, j] = max(fine[i, j], value)


@numba.njit(cache=True, fastmath=True)
def _relax(height, obstacle, gain, omega, tolerance):  # type: ignore[no-untyped-def]
    """Relax by projected red-black over-relaxation."""
    rows, cols = height.shape
    # Red, then black: nodes of one colour have neighbours of the other only, so their order does
    # not matter.
    for _ in range(SWEEPS):
        change = np.float32(0)
        for colour in range(2):
            for i in range(1, rows - 1):
                for j in range(1 + (i + colour) % 2, cols - 1, 2):
                    old = height[i, j]
                    total = (
                        height[i - 1, j] + height[i + 1, j] + height[i, j - 1] + height[i, j + 1]
                    )
                    new = max(old + omega * (total * gain[i, j] - old), obstacle[i, j])
                    change = max(change, abs(new - old))
                    height[i, j] = new
        if change < tolerance:
            break


def slid(held: F32, limit: F32, mass: F32) -> F32:
    """Solve like `lab.simulator.skin.slid`."""
    return uncompiled.slid(held, limit, mass, _slide)


@numba.njit(cache=True, fastmath=True)
def _slide(w, held, limit, mass):  # type: ignore[no-untyped-def]
    """Relax by projected red-black over-relaxation."""
    omega, tolerance = np.float32(RELAXATION), np.float32(SLID_TOLERANCE_MM * (2 - RELAXATION))
    _, rows, cols = w.shape
    for _ in range(SWEEPS):
        change = np.float32(0)
        for colour in range(2):
            for i in range(1, rows - 1):
                for j in range(1 + (i + 1 + colour) % 2, cols - 1, 2):
                    diagonal = 4 + mass[i, j]
                    x = w[0, i - 1, j] + w[0, i + 1, j] + w[0, i, j - 1] + w[0, i, j + 1]
                    y = w[1, i - 1, j] + w[1, i + 1, j] + w[1, i, j - 1] + w[1, i, j + 1]
                    if limit[i, j] > 0:
                        qx, qy = held[0, i, j] * diagonal - x, held[1, i, j] * diagonal - y
                        part = min(
                            limit[i, j] / max(math.sqrt(qx * qx + qy * qy), np.float32(1e-12)),
                            np.float32(1),
                        )
                        x, y = x + part * qx, y + part * qy
                    x, y = x / diagonal - w[0, i, j], y / diagonal - w[1, i, j]
                    change = max(change, abs(x), abs(y))
                    w[0, i, j] += omega * x
                    w[1, i, j] += omega * y
        if change < tolerance:
            break


def carry(contacts: Contacts, weight: F32, step_mm: float, model: SensorModel) -> F32:
    """Carry like `lab.simulator.drag.carry`."""
    return drag.carry(contacts, weight, step_mm, model, slid)


def skin_points(skin: Skin, geometry: Geometry, row: F64, col: F64) -> F64:
    """Compute the same points as `lab.simulator.truth.skin_points`."""
    origin, along = pixel_rays(geometry, row, col)
    # A dome alone: no twin of a flat skin is simulated.
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
def _march(  # type: ignore[no-untyped-def]
    origin, along, height, radius, step, least, most, points
):
    for k in range(len(origin)):
        ox, oy, oz = origin[k]
        ax, ay, az = along[k]
        foot = -(ox * ax + oy * ay + oz * az)
        off_axis = ox * ox + oy * oy + oz * oz - foot * foot
        low = foot + math.sqrt(max(least * least - off_axis, 0.0))
        end = foot + math.sqrt(max(most * most - off_axis, 0.0))
        start, each, high = low, (end - low) / MARCH_STEPS, low
        f_low, f_high = (
            _outside(ox + low * ax, oy + low * ay, oz + low * az, height, radius, step),
            0.0,
        )
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
                    # The Illinois variant: halving the end that stays keeps the secant moving.
                    high, f_high, f_low = s, f, f_low / 2
                else:
                    low, f_low, f_high = s, f, f_high / 2
        at_low = abs(_outside(ox + low * ax, oy + low * ay, oz + low * az, height, radius, step))
        at_high = abs(
            _outside(ox + high * ax, oy + high * ay, oz + high * az, height, radius, step)
        )
        best = low if at_low < at_high else high
        points[k, 0], points[k, 1], points[k, 2] = ox + best * ax, oy + best * ay, oz + best * az


@numba.njit(cache=True, fastmath=True, inline="always")
def _bilinear(grid, x, y):  # type: ignore[no-untyped-def]
    """Sample at (x, y) steps from the middle node, like `lab.simulator.skin.bilinear`."""
    n = grid.shape[0] // 2
    col, row = min(max(x + n, 0.0), 2.0 * n), min(max(y + n, 0.0), 2.0 * n)
    j, i = min(int(col), 2 * n - 1), min(int(row), 2 * n - 1)
    a, b = col - j, row - i
    top = grid[i, j] * (1 - a) + grid[i, j + 1] * a
    bottom = grid[i + 1, j] * (1 - a) + grid[i + 1, j + 1] * a
    return top * (1 - b) + bottom * b


@numba.njit(cache=True, fastmath=True, inline="always")
def _inwards(x, y, pressed, radius, step, friction):  # type: ignore[no-untyped-def]
    """Where `Skin.carried_inwards` moves a material point, in the chart."""
    u, v = x / radius, y / radius
    q = (u * u + v * v) / 4
    dx, dy, dz = u / (1 + q), v / (1 + q), (1 - q) / (1 + q)
    h = _bilinear(pressed, x / step, y / step)
    along = radius - (1 - friction) * h
    mx, my, mz = dx * along, dy * along, dz * along - friction * h / dz
    k = 2 * radius / (math.sqrt(mx * mx + my * my + mz * mz) + mz)
    return mx * k, my * k


@numba.njit(cache=True, fastmath=True)
def _carry(  # type: ignore[no-untyped-def]
    chart, pressed, across, down, radius, step, friction, now
):
    for p in range(len(chart)):
        x, y = chart[p, 0], chart[p, 1]
        a, b = _inwards(x, y, pressed, radius, step, friction)
        for _ in range(DRAG_STEPS):
            c, d = _inwards(
                x - _bilinear(across, a / step, b / step),
                y - _bilinear(down, a / step, b / step),
                pressed,
                radius,
                step,
                friction,
            )
            off = max(abs(c - a), abs(d - b))
            a, b = c, d
            if off < DRAG_TOLERANCE_MM:
                break
        now[p, 0], now[p, 1] = a, b


@numba.njit(cache=True, fastmath=True)
def _undo(now, pressed, radius, step, friction, before):  # type: ignore[no-untyped-def]
    # A fixed point, as in the simulator: shear is small beside the lengths over which it changes.
    for p in range(len(now)):
        x, y = now[p, 0], now[p, 1]
        for _ in range(INVERSE_STEPS):
            a, b = _inwards(x, y, pressed, radius, step, friction)
            off = max(abs(now[p, 0] - a), abs(now[p, 1] - b))
            x += now[p, 0] - a
            y += now[p, 1] - b
            if off < INVERSE_TOLERANCE_MM:
                break
        before[p, 0], before[p, 1] = x, y


def carried(skin: Skin, chart_mm: F64, friction: float) -> tuple[F64, F64]:
    """Directions and chart coordinates of material points that the deformation moves,
    like `render.carried`.
    """
    flat = np.ascontiguousarray(chart_mm.reshape(-1, 2))
    now = np.empty_like(flat)
    origin = (
        np.zeros((2, *skin.height_mm.shape), np.float32)
        if skin.origin_mm is None
        else skin.origin_mm.transpose(2, 0, 1)
    )
    # Contiguous by component: the loops read one of them at a time.
    across, down = (np.ascontiguousarray(each, np.float32) for each in origin)
    _carry(flat, skin.pressed_mm, across, down, skin.radius_mm, skin.step_mm, friction, now)
    now = now.reshape(chart_mm.shape)
    return chart_to_direction(now[..., 0], now[..., 1], skin.radius_mm), now


def shear_mm(skin: Skin, points_mm: F64, friction: float) -> F64:
    """Compute the same shear as `lab.simulator.truth.shear_mm`."""
    now: F64 = np.stack(direction_to_chart(points_mm, skin.radius_mm), axis=-1)
    before = np.empty_like(now)
    _undo(now, skin.pressed_mm, skin.radius_mm, skin.step_mm, friction, before)
    before += skin.sample_origin(now[:, 0], now[:, 1])
    return np.asarray(
        points_mm[:, :2]
        - skin.radius_mm * chart_to_direction(before[:, 0], before[:, 1], skin.radius_mm)[:, :2]
    )
