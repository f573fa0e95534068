"""Render a skin to an image: pins and markers through the camera, then light, blur, surround,
noise.

The renderer does not hide skin behind its own steep folds; at visible half angles up to 55° and
folds below 70° to the sphere, nothing is hidden.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.lab.simulator.sensor_model import MAX_VISIBLE_HALF_ANGLE_DEG, SensorModel
from tacshade_edge.lab.simulator.skin import Skin, at_height, direction_to_chart
from tacshade_edge.types import F32, F64, U8, Geometry

_MARKER_CORNERS = 12
_FLAT_REACH = 1.12
"""How far the print of a pad or of a nearly flat dome reaches, in radii of the visible circle."""


@dataclass(frozen=True, slots=True)
class PinProfile:
    """The pin's outline between base and tip, as cones between rings.

    `rings`: each ring's height (0 at the base, 1 at the tip) and its radius, the sum of a part of
    the base's radius and a part of the tip's.
    """

    rings: tuple[tuple[float, float, float], ...]

    @classmethod
    def waist(cls, height: float, part: float) -> PinProfile:
        """Make a frustum whose radius at a height is multiplied by `part`,
        which gives a waist or a belly.
        """
        return cls(((height, part * (1 - height), part * height),))


FRUSTUM, CAP = PinProfile(()), PinProfile(((1.0, 0.7, 0.0),))
"""Cones between base and tip, and tapering stems under flat caps."""


@dataclass(frozen=True, slots=True, eq=False)
class Print:
    """The printed features of one sensor, on the undeformed skin.

    `marker_chart_mm` (float (M, corners, 2)): outlines of the markers in the skin's chart; they are
    on the skin and deform with it. `pin_chart_mm` (float (P, 2)): positions of the pins in the
    skin's chart. `pin_base_mm`, `pin_tip_mm`, `pin_length_mm`: float (P,).
    """

    marker_chart_mm: F64
    pin_chart_mm: F64
    pin_base_mm: F64
    pin_tip_mm: F64
    pin_length_mm: F64


def print_features(model: SensorModel) -> Print:
    """Lay the hexagonal lattice on the skin (equal-area chart)
    with the model's print tolerances.
    """
    p, (r, size_mm) = model.pitch_mm, model.form_mm
    reach = math.radians(min(model.visible_half_angle_deg + 6.0, MAX_VISIBLE_HALF_ANGLE_DEG + 4.0))
    limit = 2 * r * math.sin(reach / 2) if r == size_mm else reach_mm(model)
    n = math.ceil(limit / (p * 0.86)) + 1
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    corner = np.stack(((i + 0.5 * j).ravel(), (j * math.sqrt(0.75)).ravel()), axis=1) * p
    third = (
        np.array((0.5, math.sqrt(1 / 12))) * p
    )  # centre of the triangle right above a lattice point
    a = math.radians(model.lattice_rotation_deg)
    turn = np.array(((math.cos(a), math.sin(a)), (-math.sin(a), math.cos(a))))
    # The second triangle of each lattice cell is the first one mirrored in the cell's middle.
    markers = np.concatenate((corner + third, corner - third))
    # Regular polygons of the same area as the discs.
    area = math.sqrt(2 * math.pi / (_MARKER_CORNERS * math.sin(2 * math.pi / _MARKER_CORNERS)))
    return _printed(model, 1, corner @ turn, markers @ turn, limit, area)


def reach_mm(model: SensorModel) -> float:
    """Compute how far from the apex the print reaches, in the equal-area chart."""
    radius_mm, size_mm = model.form_mm
    if radius_mm > size_mm:
        return _FLAT_REACH * model.geometry.visible_radius_mm
    return 2 * model.skin_radius_mm * math.sin(math.radians(model.visible_half_angle_deg + 6) / 2)


def print_at(model: SensorModel, pins_mm: F64, markers_mm: F64) -> Print:
    """Print pins and markers at points (N, 2) of the equal-area chart,
    with the model's tolerances.
    """
    return _printed(model, 14, pins_mm, markers_mm, reach_mm(model), 1.0)


def _printed(
    model: SensorModel, stream: int, pins: F64, markers: F64, limit_mm: float, marker_part: float
) -> Print:
    """Print at points of the equal-area chart within a limit,
    with tolerances drawn from a stream.
    """
    rng, (r, _) = np.random.default_rng((model.print_seed, stream)), model.form_mm

    def lay(points: F64) -> F64:
        points = points + rng.normal(0.0, model.position_tolerance_mm, points.shape)
        return np.asarray(points[np.linalg.norm(points, axis=1) < limit_mm])

    def sizes(pitches: float, count: int) -> F64:
        tolerance = np.clip(1 + model.size_tolerance * rng.standard_normal(count), 0.5, 1.5)
        return np.asarray(pitches * model.pitch_mm * tolerance)

    pins, markers = lay(pins), lay(markers)
    radius = sizes(model.marker_radius_pitches, len(markers)) * marker_part
    angles = np.arange(_MARKER_CORNERS) * (2 * math.pi / _MARKER_CORNERS)
    circle = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    centre = equal_area_to_direction(markers, r)
    flat = math.isinf(r)
    east, north = tangents(np.broadcast_to((0.0, 0.0, 1.0), centre.shape) if flat else centre)
    ring = (centre if flat else centre * r)[:, None, :] + radius[:, None, None] * (
        circle[None, :, :1] * east[:, None, :] + circle[None, :, 1:] * north[:, None, :]
    )
    return Print(
        marker_chart_mm=np.stack(direction_to_chart(ring, r), axis=-1),
        pin_chart_mm=np.stack(direction_to_chart(equal_area_to_direction(pins, r), r), axis=-1),
        pin_base_mm=sizes(model.pin_base_radius_pitches, len(pins)),
        pin_tip_mm=sizes(model.pin_tip_radius_pitches, len(pins)),
        pin_length_mm=sizes(model.pin_length_pitches, len(pins)),
    )


def equal_area_to_direction(points: F64, radius: float) -> F64:
    """Convert Lambert's equal-area chart to unit vectors, or on a pad to points of the plane; the
    lattice keeps its density all over the skin.
    """
    if math.isinf(radius):
        return np.concatenate((points, np.zeros((*points.shape[:-1], 1))), axis=-1)
    x, y = points[..., 0] / radius, points[..., 1] / radius
    s = x * x + y * y
    k = np.sqrt(np.maximum(1 - s / 4, 0))
    return np.stack((x * k, y * k, 1 - s / 2), axis=-1)


_ALONG_X = 0.9
"""Beyond, a normal is so nearly along x that its cross product with x is mostly rounding."""


def tangents(normal: F64) -> tuple[F64, F64]:
    """Two unit vectors (P, 3) perpendicular to each unit normal."""
    helper = np.where(np.abs(normal[:, :1]) < _ALONG_X, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    first = np.cross(normal, helper)
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normal, first)


_SUPERSAMPLING = 2
# Fractional bits of drawn coordinates: without them a pin would jump by pixels as the skin moves.
_SHIFT = 4
_PIN_CORNERS = 10
_DRAG_STEPS = 40
_DRAG_TOLERANCE_MM = 2e-3


def project(geometry: Geometry, points_mm: F64) -> F64:
    """Image coordinates (col, row) of points (..., 3) in the sensor frame;
    pixel centres are integers.
    """
    disc = geometry.disc
    if geometry.camera_distance_mm is None:
        scale = np.asarray(1 / geometry.mm_per_px)
    else:
        scale = geometry.f_px / (points_mm[..., 2] + geometry.camera_distance_mm)
    return np.stack(
        (disc.col_c + scale * points_mm[..., 0], disc.row_c + scale * points_mm[..., 1]), axis=-1
    )


class Renderer:
    """Draws one sensor's frames, with another print than the model's if one is given."""

    def __init__(
        self, model: SensorModel, marks: Print | None = None, profile: PinProfile = FRUSTUM
    ) -> None:
        self.model = model
        self.print = print_features(model) if marks is None else marks
        self._profile = profile
        rows, cols = np.mgrid[: model.image_height_px, : model.image_width_px].astype(np.float32)
        rho = np.hypot(rows - model.row_c, cols - model.col_c) / model.disc_radius_px
        self._inside = np.clip((1 - rho) * model.disc_radius_px + 0.5, 0, 1).astype(np.float32)
        # A stream of its own, so that light and glints do not depend on how many pins there are.
        rng = np.random.default_rng((model.print_seed, 2))
        light = model.light * (1 - model.vignetting * np.minimum(rho, 1.2) ** 2)
        angle = np.arctan2(rows - model.row_c, cols - model.col_c)
        # LEDs differ: one side of the circle is brighter by 5 %.
        self._light = (
            light * (1 + 0.05 * np.cos(angle - rng.uniform(0, 6.3)) * np.minimum(rho, 1))
        ).astype(np.float32)
        self._outside = _surround(model, rho, angle) * (1 - self._inside)
        self._glints = _glints(model, rng, rows, cols)

    def draw(self, skin: Skin) -> F32:
        """The noiseless image of a skin: float32 (H, W), grey levels before the colour gains."""
        model = self.model
        reflectance = self._features(skin).astype(np.float32)
        image = reflectance * self._light * (self._inside / 255) + self._outside + self._glints
        if model.blur_px > 0:
            image = cv2.GaussianBlur(image, (0, 0), model.blur_px)
        return np.asarray(image, np.float32)

    def expose(self, image: F32, noise_seed: int) -> U8:
        """Add the camera's noise and colour, and quantise: uint8 (H, W, 3) BGR."""
        level = self.level(image, noise_seed)
        # White balance comes after quantisation, so that channels share their steps.
        ramp = np.arange(256)[None, :, None] * np.array(self.model.colour_bgr)
        table = np.clip(ramp + 0.5, 0, 255).astype(np.uint8)
        return np.asarray(cv2.LUT(cv2.merge((level, level, level)), table), np.uint8)

    def level(self, image: F32, noise_seed: int) -> U8:
        """Add the camera's noise, and quantise: uint8 (H, W), the same for the three channels,
        because demosaicking leaves nearly the same noise in each.
        """
        model, rng = self.model, np.random.default_rng((noise_seed, 3))
        # Photons: the variance grows with the level.
        variance = model.read_noise_grey**2 + np.maximum(image, 0) * (
            model.shot_noise_grey**2 / 255
        )
        grey = image + np.sqrt(variance) * rng.standard_normal(image.shape, np.float32)
        return np.asarray(np.clip(grey + 0.5, 0, 255), np.uint8)

    def _features(self, skin: Skin) -> U8:
        """Reflectance times 255, (H, W): markers on the skin, pins over them."""
        model, marks = self.model, self.print
        size = (model.image_height_px * _SUPERSAMPLING, model.image_width_px * _SUPERSAMPLING)
        reflectances = (
            model.skin_reflectance,
            model.marker_reflectance,
            model.pin_reflectance,
            model.pin_tip_reflectance,
        )
        ground, white, black, tip_level = (round(255 * each) for each in reflectances)
        canvas = np.full(size, ground, np.uint8)
        # Printed features are stiffer than the gel: they follow its mean, not each crease.
        smooth = smoothed(skin, float(np.mean(marks.pin_base_mm)))
        outline = _on_skin(skin, *self._carried(smooth, marks.marker_chart_mm, model.friction))
        for polygon in _to_canvas(project(model.geometry, outline)):
            cv2.fillConvexPoly(canvas, polygon, white, cv2.LINE_8, _SHIFT)
        pins = self._pins_on(skin, smooth)

        def disc(height: float, radius_mm: F64) -> np.typing.NDArray[np.int32]:
            return _to_canvas(
                project(model.geometry, pins.disc(height * marks.pin_length_mm, radius_mm))
            )

        def fill(polygons: np.typing.NDArray[np.int32]) -> None:
            for polygon in polygons:
                # In perspective, the side of a frustum is nearly the hull of its two discs.
                cv2.fillConvexPoly(canvas, cv2.convexHull(polygon), black, cv2.LINE_8, _SHIFT)

        # From the skin inwards: pins hide markers, and each ring what lies below it.
        below = disc(0.0, marks.pin_base_mm)
        for height, of_base, of_tip in self._profile.rings:
            ring = disc(height, of_base * marks.pin_base_mm + of_tip * marks.pin_tip_mm)
            fill(np.concatenate((below, ring), axis=1))
            below = ring
        tip = disc(1.0, marks.pin_tip_mm)
        fill(np.concatenate((below, tip), axis=1))
        if tip_level != black:
            for polygon in tip:
                cv2.fillConvexPoly(canvas, polygon, tip_level, cv2.LINE_8, _SHIFT)
        return np.asarray(
            cv2.resize(
                canvas, (model.image_width_px, model.image_height_px), interpolation=cv2.INTER_AREA
            )
        )

    def _pins_on(self, skin: Skin, smooth: Skin) -> _Pins:
        direction, chart = self._carried(smooth, self.print.pin_chart_mm, self.model.friction)
        normal = _outward_normals(smooth, chart)
        lag = np.zeros_like(normal)
        if skin.origin_mm is not None:
            # Tips hang in the gel, which moves less than the skin.
            lag[:, :2] = self.model.pin_lag * skin.sample_origin(chart[:, 0], chart[:, 1])
        return _Pins(_on_skin(skin, direction, chart), normal, *tangents(normal), lag)

    def _carried(self, skin: Skin, chart_mm: F64, friction: float) -> tuple[F64, F64]:
        return carried(skin, chart_mm, friction)


@dataclass(frozen=True, slots=True, eq=False)
class _Pins:
    """Every pin on a skin, each array (P, 3): its base's middle, its axes,
    and by how much its tip leads in a drag.
    """

    base_mm: F64
    normal: F64
    east: F64
    north: F64
    lead_mm: F64

    def disc(self, height_mm: F64, radius_mm: F64) -> F64:
        """Corners of a disc at a height of every pin, (P, corners, 3)."""
        angles = np.arange(_PIN_CORNERS) * (2 * math.pi / _PIN_CORNERS)
        circle = (
            np.cos(angles)[:, None] * self.east[:, None]
            + np.sin(angles)[:, None] * self.north[:, None]
        )
        middle = (
            self.base_mm
            - self.normal * height_mm[:, None]
            + self.lead_mm * (height_mm > 0)[:, None]
        )
        return np.asarray(middle[:, None] + circle * radius_mm[:, None, None])


def carried(skin: Skin, chart_mm: F64, friction: float) -> tuple[F64, F64]:
    """New directions (..., 3) and chart coordinates (...,
    2) of material points that the deformation moves.
    """
    direction, now = skin.carried_inwards(chart_mm, friction)
    if skin.origin_mm is None:
        return direction, now
    # A contraction, because `drag` lets no skin fold.
    for _ in range(_DRAG_STEPS):
        before = now
        direction, now = skin.carried_inwards(
            chart_mm - skin.sample_origin(now[..., 0], now[..., 1]), friction
        )
        if np.abs(now - before).max(initial=0) < _DRAG_TOLERANCE_MM:
            break
    return direction, now


def _on_skin(skin: Skin, direction: F64, chart_mm: F64) -> F64:
    """Points of the deformed skin (..., 3) in mm."""
    height = skin.sample(chart_mm[..., 0], chart_mm[..., 1])
    return at_height(direction, height, skin.radius_mm)


def smoothed(skin: Skin, patch_mm: float) -> Skin:
    """The skin as a stiff printed feature senses it,
    with h averaged over a patch of the given radius.
    """
    side = 2 * max(1, round(patch_mm / skin.step_mm)) + 1
    return replace(skin, height_mm=np.asarray(cv2.blur(skin.height_mm, (side, side)), np.float32))


def _outward_normals(flat: Skin, chart_mm: F64) -> F64:
    """Outward unit normals (P, 3) of a skin that is smooth over several grid steps."""
    x, y, e = chart_mm[:, 0], chart_mm[:, 1], flat.step_mm
    h_x = (flat.sample(x + e, y) - flat.sample(x - e, y)) / (2 * e)
    h_y = (flat.sample(x, y + e) - flat.sample(x, y - e)) / (2 * e)
    if math.isinf(flat.radius_mm):
        slope = np.stack((h_x, h_y, np.ones_like(h_x)), axis=1)
        return np.asarray(slope / np.linalg.norm(slope, axis=1, keepdims=True))
    u, v = x / flat.radius_mm, y / flat.radius_mm
    q = (u * u + v * v) / 4
    direction = np.stack((u, v, 1 - q), axis=1) / (1 + q)[:, None]
    # Unit tangents of the chart's axes.
    e_x = np.stack((1 + q - u * u / 2, -u * v / 2, -u), axis=1) / (1 + q)[:, None]
    e_y = np.stack((-u * v / 2, 1 + q - v * v / 2, -v), axis=1) / (1 + q)[:, None]
    # The surface is |S| + h - r = 0; h's gradient on the unit sphere is r
    # (1 + q) times that in the chart.
    k = (flat.radius_mm * (1 + q) / (flat.radius_mm - flat.sample(x, y)))[:, None]
    normal = direction + k * (h_x[:, None] * e_x + h_y[:, None] * e_y)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _to_canvas(points: F64) -> np.typing.NDArray[np.int32]:
    """Convert image coordinates to the supersampled canvas, in fixed point."""
    s = _SUPERSAMPLING
    scaled = (points * s + (s - 1) / 2) * (1 << _SHIFT)
    # OpenCV shifts in 32 bits: a point far outside would wrap around into the picture.
    return np.clip(np.rint(scaled), -(2**24), 2**24).astype(np.int32)


def _surround(model: SensorModel, rho: F32, angle: F32) -> F32:
    """Grey levels outside the visible circle: the housing,
    plus an LED ring if the surround is bright.
    """
    if model.surround == "dark":
        return np.full(rho.shape, 10.0, np.float32)
    housing = 70 + 25 * np.cos(angle * 3 + model.print_seed)
    ring = 150 * np.exp(-(((rho - 1.12) / 0.06) ** 2)) * (1 + 0.5 * np.cos(angle * 8) ** 8)
    return np.asarray(np.minimum(housing + ring, 255), np.float32)


def _glints(model: SensorModel, rng: np.random.Generator, rows: F32, cols: F32) -> F32:
    """Specular spots of the LEDs, inside the visible circle."""
    image = np.zeros(rows.shape, np.float32)
    for _ in range(model.specular_spots):
        rho, angle = rng.uniform(0.15, 0.85) * model.disc_radius_px, rng.uniform(0, 2 * math.pi)
        size = rng.uniform(0.006, 0.014) * model.disc_radius_px
        row, col = model.row_c + rho * math.sin(angle), model.col_c + rho * math.cos(angle)
        image += 230 * np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / (2 * size * size))
    return image
