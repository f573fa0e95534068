"""One simulated sensor to its training samples: random sensor, random presses, nuisances, maps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from shapes import random_shape

from tacshade_edge.core import discmap, greyscale, pattern
from tacshade_edge.core.disc import disc_mask
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator.model import SensorModel, random_model, tactip
from tacshade_edge.simulator.press import Press, distance_mm
from tacshade_edge.simulator.render import Renderer
from tacshade_edge.simulator.skin import Skin, press_skin
from tacshade_edge.simulator.truth import CONTACT_TOLERANCE_MM, skin_points
from tacshade_edge.types import F32, U8, Bool, Disc, Geometry

N = discmap.CELLS
TACTIP_PART, SMALL_PART, ORTHOGRAPHIC_PART = 0.05, 0.15, 0.06
UNLOADED_PART, NUISANCE_PART = 0.05, 0.5


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


def pressed_skin(model: SensorModel, rng: np.random.Generator) -> tuple[Skin, tuple[Press, ...]]:
    """A skin under random objects, moved along z so that the deepest point is what was asked for."""
    while True:
        presses = random_presses(model, rng)
        target = max(p.depth_mm for p in presses)
        try:
            depth = 0.0
            for _ in range(2):
                first = press_skin(model.skin_radius_mm, model.skin_decay_mm, presses)
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
    return discmap.disc_average(greyscale.binarise(greyscale.to_grey(image), mask, "adaptive", pitch_px), disc)


def true_maps(skin: Skin, presses: Sequence[Press], geometry: Geometry, seen: Disc) -> tuple[F32, Bool]:
    """H in disc radii (mm over r sinθ) and contact at the middles of the cells of the disc that was `seen`."""
    grid = discmap.map_grid(seen)
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
    model = training_model(seed)
    renderer = Renderer(model)
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
        skin, presses = (flat, ()) if rng.random() < UNLOADED_PART else pressed_skin(model, rng)
        image = renderer.expose(renderer.draw(skin), int(rng.integers(1 << 30)))
        if rng.random() < NUISANCE_PART:
            image = spoil(image, disc, rng)
        height, contact = true_maps(skin, presses, model.geometry, disc)
        maps.append(np.rint(255 * white_map(image, mask, disc, pitch_px)).astype(np.uint8))
        heights.append(height.astype(np.float16))
        contacts.append(contact)
    return Samples(
        reference=np.rint(255 * reference).astype(np.uint8),
        known=discmap.geometry_maps(seen, pitch_px),
        frame=np.stack(maps),
        height=np.stack(heights),
        contact=np.stack(contacts),
    )


cv2.setNumThreads(1)
