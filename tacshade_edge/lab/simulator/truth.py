"""Ground truth: the result of a perfect reconstruction of a simulated frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.lab.simulator.drag import drag_skin
from tacshade_edge.lab.simulator.press import Press, distance_mm
from tacshade_edge.lab.simulator.render import Renderer
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import (
    Skin,
    at_height,
    chart_to_direction,
    direction_to_chart,
    height_of,
    press_skin,
    rest_x_y_mm,
)
from tacshade_edge.types import F32, F64, U8, Bool, Geometry

# The solver and the march leave less; the skirt leaves the object steeper than that.
CONTACT_TOLERANCE_MM = 0.02
"""Skin within this distance of the object touches it; the elastic skirt does not."""

_MARCH_STEPS = 16
_REFINE_STEPS = 8
# The march ends on the least sphere around the skin, so a ray to undeformed skin comes no further
# than to 0, and rounding may leave it below.
_ON_SKIN_MM = 1e-9
_LEAST_GAP_MM = 1e-12
_LEAST_MM = 1e-6  # less is rounding: `measure` calls it undeformed
_INVERSE_STEPS = 60
_INVERSE_TOLERANCE_MM = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """True values at the pixels: h of the skin point that the ray meets (NaN outside the disc);
    whether it touches; the touching points (N, 3); the objects' surfaces inside the undeformed skin
    (M, 3); the greatest h over the disc.
    """

    height_mm: F32
    contact: Bool
    points_mm: F32
    object_points_mm: F32
    depth_max_mm: float


def measure(
    skin: Skin, presses: Sequence[Press], geometry: Geometry, shape: tuple[int, int]
) -> Truth:
    """Intersect the ray of every pixel of an image of a shape with a skin and the presses
    that shaped it.
    """
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    disc = geometry.disc
    inside = np.hypot(rows - disc.row_c, cols - disc.col_c) <= disc.radius_px
    height = np.where(inside, np.float32(0), np.float32(np.nan))
    contact = np.zeros(shape, bool)
    if not inside.any() or not skin.height_mm.any():
        return Truth(height, contact, np.empty((0, 3), np.float32), _object_points(skin), 0.0)
    points = skin_points(skin, geometry, rows[inside].astype(float), cols[inside].astype(float))
    h = np.maximum(height_of(points, skin.radius_mm), 0)
    h[h < _LEAST_MM] = 0
    height[inside] = h
    # An object may touch a leaning dome where it bulges outwards.
    touching = np.ones(len(h), bool) if skin.leaning_mm is not None else h > 0
    touching[touching] = (
        np.abs(distance_mm(presses, skin.radius_mm, points[touching])) <= CONTACT_TOLERANCE_MM
        if len(presses)
        else False
    )
    contact[inside] = touching
    return Truth(
        height, contact, points[touching].astype(np.float32), _object_points(skin), float(h.max())
    )


def skin_points(skin: Skin, geometry: Geometry, row: F64, col: F64) -> F64:
    """The points (N, 3) where the pixels' rays from the camera first meet the deformed skin; the
    point nearest to O for a ray that misses the sphere.
    """
    origin, along = pixel_rays(geometry, row, col)
    r = skin.radius_mm
    foot = -np.sum(origin * along, axis=1)
    off_axis = np.sum(origin * origin, axis=1) - foot * foot

    def root(height_mm: float) -> F64:
        if math.isinf(r):
            return np.asarray((-height_mm - origin[:, 2]) / along[:, 2])
        radius = r - height_mm
        return np.asarray(foot + np.sqrt(np.maximum(radius * radius - off_axis, 0)))

    def outside(s: F64, which: Bool | slice) -> F64:
        p = origin[which] + s[:, None] * along[which]
        above = p[:, 2] if math.isinf(r) else np.linalg.norm(p, axis=1) - r
        return np.asarray(above + skin.sample(*direction_to_chart(p, r)))

    low, high = root(float(skin.height_mm.max())), root(min(float(skin.height_mm.min()), 0))
    # Most rays cross the skin once, where it is undeformed or gently deformed; march nevertheless.
    everything = slice(None)
    # Between the spheres that the deepest and the highest skin lie on: nothing is outside them.
    start, step = low.copy(), (high - low) / _MARCH_STEPS
    f_low = outside(low, everything)
    f_high = np.zeros_like(f_low)
    searching = f_low < 0
    high = np.where(searching, high, low)
    # All rays at once: those that have crossed drop out.
    for k in range(1, _MARCH_STEPS + 1):
        s = (start + k * step)[searching]
        f = outside(s, searching)
        index = np.flatnonzero(searching)
        crossed = f >= -_ON_SKIN_MM
        high[index[crossed]], f_high[index[crossed]] = s[crossed], np.maximum(f[crossed], 0)
        low[index[~crossed]], f_low[index[~crossed]] = s[~crossed], f[~crossed]
        searching[index[crossed]] = False
    for _ in range(_REFINE_STEPS):  # the Illinois variant of regula falsi
        gap = f_high - f_low
        wide = gap > _LEAST_GAP_MM
        s = np.where(wide, (low * f_high - high * f_low) / np.where(wide, gap, 1), high)
        f = outside(s, everything)
        up = f >= 0
        f_low, f_high = np.where(up, f_low / 2, f), np.where(up, f, f_high / 2)
        low, high = np.where(up, low, s), np.where(up, s, high)
    # The Illinois variant may stop with either end nearer.
    best = np.where(np.abs(outside(low, everything)) < np.abs(outside(high, everything)), low, high)
    return origin + best[:, None] * along


def shear_mm(skin: Skin, points_mm: F64, friction: float) -> F64:
    """Shear (N, 2) along x and y, from every cause, of the material at points (N, 3) of a deformed
    skin: present x, y minus those in the undeformed skin.
    """
    now = np.stack(direction_to_chart(points_mm, skin.radius_mm), axis=-1)
    before = now.copy()
    for _ in range(_INVERSE_STEPS):  # undo the motion along -z by fixed-point iteration
        off = now - skin.carried_inwards(before, friction)[1]
        before += off
        if np.abs(off).max(initial=0) < _INVERSE_TOLERANCE_MM:
            break
    before += skin.sample_origin(now[:, 0], now[:, 1])
    return np.asarray(points_mm[:, :2] - rest_x_y_mm(before, skin.radius_mm))


def pixel_rays(geometry: Geometry, row: F64, col: F64) -> tuple[F64, F64]:
    """Origins in mm and unit directions of the pixels' rays, each (N, 3),
    for the pinhole or orthographic camera.
    """
    u, v = col - geometry.disc.col_c, row - geometry.disc.row_c
    zero = np.zeros_like(u)
    if geometry.camera_distance_mm is None:
        scale = geometry.mm_per_px
        return np.stack((u * scale, v * scale, zero), axis=1), np.stack(
            (zero, zero, zero + 1), axis=1
        )
    along = np.stack((u / geometry.f_px, v / geometry.f_px, zero + 1), axis=1)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack((zero, zero, zero - geometry.camera_distance_mm), axis=1), along


def _object_points(skin: Skin) -> F32:
    i, j = np.nonzero(skin.obstacle_mm > 0)
    n = skin.height_mm.shape[0] // 2
    direction = chart_to_direction((j - n) * skin.step_mm, (i - n) * skin.step_mm, skin.radius_mm)
    depth = skin.obstacle_mm if skin.leaning_mm is None else skin.obstacle_mm + skin.leaning_mm
    return np.asarray(at_height(direction, depth[i, j], skin.radius_mm), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedFrame:
    """An image (BGR) with its presses, skin and model."""

    image: U8
    presses: tuple[Press, ...]
    skin: Skin
    model: SensorModel

    def truth(self) -> Truth:
        """Measure the ground truth (under half a second at 640x480)."""
        shape = (self.model.image_height_px, self.model.image_width_px)
        return measure(self.skin, self.presses, self.model.geometry, shape)

    def shear_mm(self, row: F64, col: F64) -> F64:
        """Shear (N, 2), x and y in mm, of the material that the rays
        of pixels inside the disc meet.
        """
        return shear_mm(
            self.skin, skin_points(self.skin, self.model.geometry, row, col), self.model.friction
        )


class SimulatedSensor:
    """A simulated sensor.

    The same presses and the same noise seed give the same frame, bit for bit.
    """

    def __init__(self, model: SensorModel | None = None) -> None:
        self.model = model or SensorModel()
        self._renderer = Renderer(self.model)
        # A held press costs only its noise.
        self._last: tuple[tuple[Press, ...], Skin] | None = None
        self._drawn: tuple[Skin, F32] | None = None

    def frame(self, presses: Sequence[Press] = (), noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture under presses; several at once act as their union.

        Raises ValueError if one is not over the skin, or reaches the middle of the sensor.
        """
        key = tuple(presses)
        if self._last is None or self._last[0] != key:
            self._last = key, self.skin(key)
        skin = self._last[1]
        return SimulatedFrame(self.picture(skin, noise_seed), key, skin, self.model)

    def skin(self, presses: Sequence[Press] = ()) -> Skin:
        """Shape the skin without taking a picture. Raises ValueError as `frame` does."""
        return skin_under(self.model, presses)

    def picture(self, skin: Skin, noise_seed: int = 0) -> U8:
        """Take a picture of a skin: uint8 (H, W, 3) BGR."""
        if self._drawn is None or self._drawn[0] is not skin:
            self._drawn = skin, self._renderer.draw(skin)
        return self._renderer.expose(self._drawn[1], noise_seed)


def skin_under(model: SensorModel, presses: Sequence[Press], rest: Skin | None = None) -> Skin:
    """Shape a sensor's skin under presses; `rest` is the unloaded skin after creep.

    Raises ValueError as `SimulatedSensor.frame`.
    """
    rest_mm = None if rest is None else rest.pressed_mm

    def shape(leaning_mm: F32 | None) -> Skin:
        radius_mm, size_mm = model.form_mm
        decay_mm = model.skin_decay_mm
        return press_skin(radius_mm, decay_mm, presses, leaning_mm, rest_mm, size_mm=size_mm)

    return drag_skin(shape, model, presses, rest=rest)
