"""One simulated sensor to its training samples: random sensor, random presses, nuisances, maps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from shapes import random_shape
from varied import pin_outline, varied_model, varied_print, with_skirt

from tacshade_edge.core.calibration import pattern
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.disc import Window, disc_mask
from tacshade_edge.core.image import greyscale
from tacshade_edge.core.image.binarise import binarise
from tacshade_edge.core.image.integral_image import CellMeans, Integrator
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator import skin as skin_module
from tacshade_edge.simulator.model import SensorModel, random_model, tactip
from tacshade_edge.simulator.other_family import CAPS, other_model, two_scale_skin
from tacshade_edge.simulator.press import Press, distance_mm
from tacshade_edge.simulator.render import Renderer, print_features
from tacshade_edge.simulator.skin import Skin, press_skin
from tacshade_edge.simulator.truth import CONTACT_TOLERANCE_MM, skin_points
from tacshade_edge.simulator.varied_print import PinProfile, VariedRenderer, lattice_print
from tacshade_edge.types import F32, U8, Bool, Disc, Geometry

N = disc_map.CELLS
TACTIP_PART, SMALL_PART, ORTHOGRAPHIC_PART = 0.05, 0.15, 0.06
UNLOADED_PART, NUISANCE_PART = 0.05, 0.5

UNEVEN_FROM = 200_000
"""Sensors of seeds from here on also have skins of uneven stiffness, pins with a waist or a belly, and stretched
lattices or skewed ones with one marker a cell: the network should trust no skirt, pin or lattice too much. The family
that evaluate.py calls "other" is none of these: square lattice, stems with caps, two decay lengths."""

WIDE_FROM = 300_000
"""From here on they are more uneven still, their skins stiffen (or soften) as they give, and marks are misplaced."""

VARIED_FROM = 400_000
"""From here on they are also those of `varied`."""

OTHER_FROM = 550_000
"""From here on they are the family "other" itself: for the question how much of the error on it is not knowing it.
Nothing that is shipped saw one."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Frames of one sensor as the network sees them.

    Attributes
    ----------
    reference : uint8 (N, N)
    known : float32 (6, N, N)
    frame : uint8 (F, N, N)
    height : float16 (F, N, N)
        h in disc radii; 0 outside the disc.
    contact : bool (F, N, N)
    """

    reference: U8
    known: F32
    frame: U8
    height: np.typing.NDArray[np.float16]
    contact: Bool


def training_model(seed: int) -> SensorModel:
    """Draw a sensor: `random_model` with wider ranges, so that its own sensors lie well inside."""
    rng = np.random.default_rng((seed, 11))
    size = (240, 320) if rng.random() < SMALL_PART else (480, 640)
    base = random_model(seed, *size)

    def draw(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    model = replace(
        base,
        camera_distance_mm=None if rng.random() < ORTHOGRAPHIC_PART else base.camera_distance_mm,
        pitch_mm=draw(1.4, 2.5),
        pin_length_pitches=draw(1.2, 2.1),
        pin_tip_radius_pitches=draw(0.30, 0.40),
        pin_base_radius_pitches=draw(0.22, 0.34),
        marker_radius_pitches=draw(0.33, 0.50),
        skin_decay_mm=draw(1.3, 4.0),
        friction=draw(0.6, 1.0),
        vignetting=draw(0.05, 0.55),
    )
    return tactip(model) if rng.random() < TACTIP_PART else model


def random_presses(model: SensorModel, rng: np.random.Generator) -> tuple[Press, ...]:
    """Up to three objects whose deepest point is uniform up to 6.5 mm (on a skin of 20 mm)."""
    scale = model.skin_radius_mm / 20
    reach = 0.85 * model.skin_radius_mm * math.sin(math.radians(model.visible_half_angle_deg))
    target = float(rng.uniform(0.1, 6.5)) * scale
    presses = []
    for _ in range(int(rng.choice((1, 2, 3), p=(0.78, 0.15, 0.07)))):
        rho, angle = reach * rng.uniform() ** 0.6, rng.uniform(0, 2 * math.pi)
        x, y = rho * math.cos(angle), rho * math.sin(angle)
        size = float(rng.uniform(0.7, 1.3))
        depth = target - (0.0 if not presses else float(rng.uniform(0, 2)))
        presses.append(Press(random_shape(rng), x, y, depth, float(rng.uniform(0, 360)), size))
    return tuple(presses)


@dataclass(frozen=True, slots=True, eq=False)
class Unevenness:
    """How a sensor differs from the model.

    `stiffness` multiplies the foundation's over the skin's grid, and so does 1 + `hardening` h / (0.15 r); `skirt` is
    what `with_skirt` takes. `two_scales`: none of these, but the skin of the other family.
    """

    stiffness: F32
    hardening: float
    skirt: tuple[float, float]
    renderer: Renderer
    two_scales: bool = False


def draw_unevenness(model: SensorModel, rng: np.random.Generator, wide: bool, varied: bool) -> Unevenness:
    """Draw a skin of uneven stiffness, and another lattice or a stretched one, and pins with a waist or a belly."""
    hardening = float(rng.uniform(-0.3, 2.5)) if wide and rng.random() < 0.6 else 0.0
    if varied:
        model = varied_model(model, rng)
    elif wide:
        model = replace(model, position_tolerance_mm=float(rng.uniform(0, 0.1)) * model.pitch_mm)
    n = press_skin(model.skin_radius_mm, model.skin_decay_mm, ()).height_mm.shape[0]
    coarse = rng.normal(0, 0.45, (7, 7)).astype(np.float32)
    stiffness = np.exp(cv2.resize(coarse, (n, n), interpolation=cv2.INTER_CUBIC)).astype(np.float32)
    if varied:
        skirt = (float(rng.choice((0, 1)) * rng.uniform(0, 0.5)), float(rng.uniform(1, 6)))
        renderer = VariedRenderer(model, varied_print(model, rng), pin_outline(rng))
        return Unevenness(stiffness, hardening, skirt, renderer)
    if wide:
        profile = PinProfile.waist(float(rng.uniform(0.2, 0.85)), float(rng.uniform(0.6, 1.25)))
    else:
        profile = PinProfile.waist(float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.75, 1.15)))
    if rng.random() < 0.5:
        steepest, longest = (82.0, 1.25) if wide else (78.0, 1.2)
        marks = lattice_print(model, float(rng.uniform(55, steepest)), float(rng.uniform(1.0, longest)))
    else:
        marks = print_features(model)
        angle, longer = rng.uniform(0, math.pi), rng.uniform(1.0, 1.13)
        axis = np.array((math.cos(angle), math.sin(angle)))
        stretch = (np.eye(2) + np.outer(axis, axis) * (longer - 1)) / math.sqrt(longer)
        marks = replace(
            marks, marker_chart_mm=marks.marker_chart_mm @ stretch, pin_chart_mm=marks.pin_chart_mm @ stretch
        )
    return Unevenness(stiffness, hardening, (0.0, 1.0), VariedRenderer(model, marks, profile))


def uneven_skin(model: SensorModel, presses: Sequence[Press], unevenness: Unevenness | None) -> Skin:
    """`press_skin` on a foundation of uneven stiffness."""
    if unevenness is None:
        return press_skin(model.skin_radius_mm, model.skin_decay_mm, presses)
    if unevenness.two_scales:
        return two_scale_skin(model, presses)
    flat = press_skin(model.skin_radius_mm, model.skin_decay_mm, ())
    obstacle = skin_module._obstacle(model.skin_radius_mm, flat.step_mm, presses)
    if not obstacle.any():
        return flat
    weight = skin_module._mass_weight(model.skin_radius_mm, flat.step_mm, obstacle.shape[0] // 2)
    weight = weight * unevenness.stiffness * np.float32((flat.step_mm / model.skin_decay_mm) ** 2)
    window = skin_module._window(obstacle > 0, 2 + math.ceil(12 * model.skin_decay_mm / flat.step_mm))
    height = np.zeros_like(obstacle)
    height[window] = skin_module._solve(obstacle[window], np.ascontiguousarray(weight[window]))
    if unevenness.hardening:
        # One step of the fixed point: any skirt between is a skin as good.
        weight[window] *= 1 + unevenness.hardening * np.minimum(height[window] / (0.15 * model.skin_radius_mm), 2)
        height[window] = skin_module._solve(obstacle[window], np.ascontiguousarray(np.maximum(weight[window], 1e-4)))
    return with_skirt(Skin(model.skin_radius_mm, flat.step_mm, height, obstacle), *unevenness.skirt)


def pressed_skin(
    model: SensorModel, unevenness: Unevenness | None, rng: np.random.Generator
) -> tuple[Skin, tuple[Press, ...]]:
    """A skin under random objects, moved along z so that the deepest point is what was asked for."""
    while True:
        presses = random_presses(model, rng)
        target = max(p.depth_mm for p in presses)
        try:
            depth = 0.0
            for _ in range(2):
                first = uneven_skin(model, presses, unevenness)
                found = float(first.obstacle_mm.max())
                if abs(found - target) < 0.3 * target or found == 0:
                    depth = found
                    break
                presses = tuple(replace(p, depth_mm=p.depth_mm + target - found) for p in presses)
        except ValueError:
            continue
        if 0 < depth < 7.5 * model.skin_radius_mm / 20:
            return first, presses


def spoil(image: U8, disc: Disc, rng: np.random.Generator) -> U8:
    """Nuisances that the daemon lets pass: other light, a pixel of shift, noise, a small glare."""
    if rng.random() < 0.6:
        image = nuisance.gain(image, float(rng.uniform(0.8, 1.2)))
    if rng.random() < 0.3:
        image = nuisance.shift(image, int(rng.integers(-1, 2)), int(rng.integers(-1, 2)))
    if rng.random() < 0.2:
        image = nuisance.noise(image, float(rng.uniform(1, 7)), int(rng.integers(1 << 30)))
    if rng.random() < 0.15:
        rho, angle = disc.radius_px * rng.uniform(0, 0.9), rng.uniform(0, 2 * math.pi)
        row, col = disc.row_c + rho * math.sin(angle), disc.col_c + rho * math.cos(angle)
        image = nuisance.glare(image, row, col, disc.radius_px * float(rng.uniform(0.01, 0.04)))
    return image


def white_map(image: U8, mask: U8, disc: Disc, pitch_px: float) -> F32:
    """Part of white in each cell, 0 to 1."""
    integrator = Integrator(Window(0, 0, *mask.shape), 0)
    white = binarise(greyscale.to_grey(image), mask, "adaptive", pitch_px)
    return CellMeans(integrator, disc_map.map_grid(disc)).means(integrator.integrate(white))


def true_maps(skin: Skin, presses: Sequence[Press], geometry: Geometry, seen: Disc) -> tuple[F32, Bool]:
    """H in disc radii (mm over r sinθ) and contact at the middles of the cells of the disc that was `seen`."""
    grid = disc_map.map_grid(seen)
    rows = np.repeat(grid.row0 + grid.step_px * np.arange(N), N)
    cols = np.tile(grid.col0 + grid.step_px * np.arange(N), N)
    disc = geometry.disc
    inside = np.hypot(rows - disc.row_c, cols - disc.col_c) <= disc.radius_px
    height, contact = np.zeros(N * N, np.float32), np.zeros(N * N, bool)
    if skin.height_mm.any():
        points = skin_points(skin, geometry, rows[inside], cols[inside])
        h = np.maximum(skin.radius_mm - np.linalg.norm(points, axis=1), 0)
        touching = h > 1e-6
        touching[touching] = np.abs(distance_mm(presses, skin.radius_mm, points[touching])) <= CONTACT_TOLERANCE_MM
        height[inside], contact[inside] = h, touching
    unit_mm = geometry.skin_radius_mm * math.sin(math.radians(geometry.visible_half_angle_deg))
    return (height / unit_mm).reshape(N, N), contact.reshape(N, N)


def sensor_samples(seed: int, frames: int) -> Samples | None:
    """Everything of one sensor; None where its reference shows no pattern to calibrate on."""
    rng = np.random.default_rng((seed, 12))
    model = other_model(seed) if seed >= OTHER_FROM else training_model(seed)
    unevenness: Unevenness | None = None
    if seed >= OTHER_FROM:
        renderer = VariedRenderer(model, lattice_print(model, 90.0), CAPS)
        unevenness = Unevenness(np.ones((1, 1), np.float32), 0.0, (0.0, 1.0), renderer, two_scales=True)
    elif seed >= UNEVEN_FROM:
        unevenness = draw_unevenness(model, rng, seed >= WIDE_FROM, seed >= VARIED_FROM)
    renderer = Renderer(model) if unevenness is None else unevenness.renderer
    flat = press_skin(model.skin_radius_mm, model.skin_decay_mm, ())
    clean = renderer.draw(flat)
    images = [renderer.expose(clean, int(rng.integers(1 << 30))) for _ in range(int(rng.choice((1, 3, 6))))]
    disc = replace(
        model.geometry.disc,
        row_c=model.row_c + float(rng.normal(0, 0.3)),
        col_c=model.col_c + float(rng.normal(0, 0.3)),
        radius_px=model.disc_radius_px * (1 + float(rng.normal(0, 0.003))),
    )
    try:
        pitch_px = pattern.marker_pitch_px(pattern.mean_image([greyscale.to_grey(i) for i in images]), disc)
    except ConfigError:
        return None
    mask = disc_mask(model.image_height_px, model.image_width_px, disc).astype(np.uint8)
    reference = np.mean([white_map(i, mask, disc, pitch_px) for i in images], axis=0)
    seen = replace(model.geometry, disc=disc)
    maps, heights, contacts = [], [], []
    for _ in range(frames):
        skin, presses = (flat, ()) if rng.random() < UNLOADED_PART else pressed_skin(model, unevenness, rng)
        image = renderer.expose(renderer.draw(skin), int(rng.integers(1 << 30)))
        if rng.random() < NUISANCE_PART:
            image = spoil(image, disc, rng)
        height, contact = true_maps(skin, presses, model.geometry, disc)
        maps.append(np.rint(255 * white_map(image, mask, disc, pitch_px)).astype(np.uint8))
        heights.append(height.astype(np.float16))
        contacts.append(contact)
    return Samples(
        reference=np.rint(255 * reference).astype(np.uint8),
        known=disc_map.geometry_maps(seen, pitch_px),
        frame=np.stack(maps),
        height=np.stack(heights),
        contact=np.stack(contacts),
    )


cv2.setNumThreads(1)
