"""Pictures of a stranger: its print on a solved skin, through its camera, in its light."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.types import F32, F64, U8
from tools.studies.strangers.camera import HEIGHT_PX, WIDTH_PX, Camera
from tools.studies.strangers.surface import Surface, View

_SUPERSAMPLING, _SHIFT, _CORNERS = 3, 4, 14
_PIN_PARTS = 5
_HOUSING_GREY = 9.0


@dataclass(frozen=True, slots=True, eq=False)
class Pins:
    """Pins that point inwards: unit directions (P, 3) of their bases, and sizes (P,) in mm.

    A pin's outline bends quadratically: its tip lags behind its base by the part `compliance` of
    the base's motion along the skin. `flare` is the radius at nine tenths of the length over the
    tip's.
    """

    direction: F64
    base_mm: F64
    tip_mm: F64
    length_mm: F64
    compliance: float
    reflectance: float
    tip_reflectance: float
    flare: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Markers:
    """Rings on the skin: directions (M, 3), outer and inner radii (M,) in mm (0: discs)."""

    direction: F64
    outer_mm: F64
    inner_mm: F64


@dataclass(frozen=True, slots=True)
class Light:
    """LEDs at places in mm, or none: then light falls off towards the edge by the part `falloff`.

    `gloss` is the level of a mirrored LED over that of white,
    `sharpness` the exponent of its fall-off.
    """

    level: float
    leds_mm: tuple[tuple[float, float, float], ...] = ()
    falloff: float = 0.0
    gloss: float = 0.0
    sharpness: float = 60.0


@dataclass(frozen=True, slots=True)
class Exposure:
    """Blur in px, noise of each channel in grey levels (read noise, and shot noise at 255),
    and each channel's gain.
    """

    blur_px: float
    read_noise_grey: float
    shot_noise_grey: float
    colour_bgr: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Painter:
    """Paints pictures of one sensor."""

    camera: Camera
    pins: Pins
    markers: Markers | None
    ground: float  # reflectance of the skin
    white: float  # of markers
    light: Light
    exposure: Exposure
    inside: F32  # (H, W) part of each pixel that lies in the visible circle

    def painted(self, surface: Surface, view: View, noise_seed: int) -> U8:
        """Paint a skin: uint8 (H, W, 3) BGR."""
        return self.exposed(self.drawn(surface, view), noise_seed)

    def drawn(self, surface: Surface, view: View) -> F32:
        """Paint a skin without noise: float32 (H, W)."""
        lit, shine = self._lit(view)
        grey = (self._features(surface) * lit + shine) * self.inside
        grey += _HOUSING_GREY * (1 - self.inside)
        return np.asarray(cv2.GaussianBlur(grey, (0, 0), self.exposure.blur_px), np.float32)

    def exposed(self, grey: F32, noise_seed: int) -> U8:
        """Add colour and noise, which is independent in each channel."""
        rng, exposure = np.random.default_rng((noise_seed, 61)), self.exposure
        image = grey[..., None] * np.array(exposure.colour_bgr, np.float32)
        variance = exposure.read_noise_grey**2 + image * (exposure.shot_noise_grey**2 / 255)
        image = image + np.sqrt(variance) * rng.standard_normal(image.shape, np.float32)
        return np.asarray(np.clip(image + 0.5, 0, 255), np.uint8)

    def _features(self, surface: Surface) -> F32:
        """Reflectance (H, W)."""
        size = (HEIGHT_PX * _SUPERSAMPLING, WIDTH_PX * _SUPERSAMPLING)
        canvas = np.full(size, round(255 * self.ground), np.uint8)
        if self.markers is not None:
            for radius, level in (
                (self.markers.outer_mm, self.white),
                (self.markers.inner_mm, self.ground),
            ):
                wanted = radius > 0
                rim = circles(surface, self.markers.direction[wanted], radius[wanted])
                self._fill(canvas, rim, level)
        rings = self._pin_rings(surface)
        for below, above in itertools.pairwise(rings):
            self._fill(canvas, np.concatenate((below, above), axis=1), self.pins.reflectance)
        if self.pins.tip_reflectance != self.pins.reflectance:
            self._fill(canvas, rings[-1], self.pins.tip_reflectance)
        small = cv2.resize(canvas, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA)
        return np.asarray(small, np.float32) / np.float32(255)

    def _fill(self, canvas: U8, points_mm: F64, reflectance: float) -> None:
        """Fill the hull of the image of each row of points."""
        at = self.camera.project(points_mm) * _SUPERSAMPLING + (_SUPERSAMPLING - 1) / 2
        for polygon in np.rint(np.clip(at, -1e5, 1e5) * (1 << _SHIFT)).astype(np.int32):
            hull = cv2.convexHull(polygon)
            cv2.fillConvexPoly(canvas, hull, round(255 * reflectance), cv2.LINE_8, _SHIFT)

    def _pin_rings(self, surface: Surface) -> list[F64]:
        """Corners (P, corners, 3) of each pin's outline at several heights, from base to tip."""
        pins = self.pins
        normal = surface.normals(pins.direction)
        base, moved = surface.points(pins.direction), surface.moved(pins.direction)
        lag = -pins.compliance * (moved - normal * np.sum(moved * normal, axis=1, keepdims=True))
        east, north = across(normal)
        angles = np.arange(_CORNERS) * (2 * math.pi / _CORNERS)
        made = []
        for part in np.linspace(0, 1, _PIN_PARTS):
            middle = base - normal * (part * pins.length_mm)[:, None] + lag * part**2
            radius = pins.base_mm + (pins.tip_mm - pins.base_mm) * part
            if 0 < part < 1:
                radius = radius * (1 + (pins.flare - 1) * math.sin(math.pi * part))
            circle = (
                np.cos(angles)[:, None] * east[:, None] + np.sin(angles)[:, None] * north[:, None]
            )
            made.append(middle[:, None] + circle * radius[:, None, None])
        return made

    def _lit(self, view: View) -> tuple[F32, F32]:
        """Grey level of white, and that of gloss, (H, W) each."""
        light = self.light
        rows, cols = np.mgrid[:HEIGHT_PX, :WIDTH_PX]
        if not light.leds_mm:
            far = np.hypot(rows - self.camera.row_c, cols - self.camera.col_c)
            edge = math.sqrt(float((self.inside > 0.5).sum()) / math.pi)
            level = light.level * (1 - light.falloff * np.minimum(far / edge, 1.3) ** 2)
            return level.astype(np.float32), np.zeros_like(self.inside)
        points, normals = np.nan_to_num(view.points_mm), np.nan_to_num(view.normals)
        lit, shine = np.zeros_like(self.inside), np.zeros_like(self.inside)
        to_eye = self.camera.place_mm - points
        to_eye /= np.linalg.norm(to_eye, axis=-1, keepdims=True)
        for led in light.leds_mm:
            to_led = np.array(led) - points
            far = np.linalg.norm(to_led, axis=-1)
            to_led /= far[..., None]
            lit += (0.3 + 0.7 * np.clip(-np.sum(to_led * normals, axis=-1), 0, 1)) / far**2
            half = to_led + to_eye
            half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
            shine += np.clip(-np.sum(half * normals, axis=-1), 0, 1) ** light.sharpness
        within = self.inside > 0.5
        lit *= light.level / float(np.percentile(lit[within], 90))
        return lit.astype(np.float32), (light.gloss * light.level * shine).astype(np.float32)


def circles(surface: Surface, direction: F64, radius_mm: F64) -> F64:
    """Circles (M, corners, 3) on the untouched skin, as they are now."""
    east, north = across(direction)
    angles = np.arange(_CORNERS) * (2 * math.pi / _CORNERS)
    far = np.linalg.norm(surface.points(direction) - surface.moved(direction), axis=1)
    circle = np.cos(angles)[:, None] * east[:, None] + np.sin(angles)[:, None] * north[:, None]
    rim = direction[:, None] + circle * (radius_mm / far)[:, None, None]
    return surface.points(rim / np.linalg.norm(rim, axis=-1, keepdims=True))


def across(normal: F64) -> tuple[F64, F64]:
    """Two unit vectors (P, 3) across each unit vector that is not along x."""
    first = np.cross(normal, (1.0, 0.0, 0.0))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normal, first)


def visible_part(camera: Camera, half_angle_deg: float, rest_mm: float) -> F32:
    """The part (H, W) of each pixel inside the image of a circle of the untouched skin,
    where the housing begins.

    `rest_mm` is the distance of the circle from O.
    """
    around = np.radians(np.arange(360.0))
    out, up = math.sin(math.radians(half_angle_deg)), math.cos(math.radians(half_angle_deg))
    rim = np.stack((out * np.cos(around), out * np.sin(around), np.full(360, up)), axis=1)
    at = camera.project(rim * rest_mm) * 4 + 1.5
    canvas = np.zeros((4 * HEIGHT_PX, 4 * WIDTH_PX), np.uint8)
    cv2.fillPoly(canvas, [np.rint(at).astype(np.int32)], 255)
    small = cv2.resize(canvas, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32) / np.float32(255)
