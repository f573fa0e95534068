"""Make the training samples of a simulated sensor: random sensor, random presses, nuisances, maps."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.core.calibration.reference import pattern
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.disc import Window, disc_mask
from tacshade_edge.core.image import greyscale
from tacshade_edge.core.image.binarise import binarise
from tacshade_edge.core.image.integral_image import CellMeans, Integrator
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator.drag import Mechanics, drag_skin
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.simulator.press import Press, distance_mm
from tacshade_edge.simulator.render import Renderer, print_features
from tacshade_edge.simulator.skin import Skin, mass_weight, obstacle_of, undeformed, window_of
from tacshade_edge.simulator.truth import CONTACT_TOLERANCE_MM, shear_mm
from tacshade_edge.types import F32, F64, U8, Bool, Disc, Geometry
from tools.testbed.simulator import camera_faults
from tools.testbed.simulator.left_over import left_over
from tools.testbed.simulator.other_family import CAPS, TURNING, other_model, two_scale_skin
from tools.testbed.simulator.tactip import tactip
from tools.testbed.simulator.varied_print import PinProfile, VariedRenderer, lattice_print
from tools.training import obstacle
from tools.training.outside import (
    VIEWS,
    Camera,
    OutsideRenderer,
    camera,
    found_circle,
    on_dome,
    outside_presses,
    printed,
    soft_dome,
)
from tools.training.rays import skin_points
from tools.training.shapes import random_shape
from tools.training.varied import pin_outline, varied_model, varied_print, with_skirt

N = disc_map.CELLS
TACTIP_PART, SMALL_PART, ORTHOGRAPHIC_PART, BULGING_PART = 0.12, 0.15, 0.06, 0.4
UNLOADED_PART, RELEASED_PART, UNDRAGGED_PART, NUISANCE_PART = 0.04, 0.04, 0.3, 0.5

UNEVEN_FROM = 200_000
"""From this seed on, sensors also have skins with uneven stiffness, pins with a waist or a belly, and lattices that are
stretched, or skewed with one marker per cell, so that the network trusts no skirt, pin or lattice too much."""

WIDE_FROM = 300_000
"""From this seed on, sensors are more uneven, their skins stiffen (or soften) under load, and marks are misplaced."""

VARIED_FROM = 400_000
"""From this seed on, sensors also have the features of `varied`."""

OTHER_FROM = 550_000
"""From this seed on, sensors belong to the family that evaluate.py calls "other"."""

OUTSIDE_FROM = 650_000
"""From this seed on, sensors are those of `outside`."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Frames of one sensor as the network sees them.

    Attributes
    ----------
    seen : Geometry
        As calibration found it.
    pitch_px : float
    reference : uint8 (N, N)
    frame : uint8 (F, N, N)
    height : float16 (F, N, N)
        h in disc radii; 0 outside the disc.
    contact : bool (F, N, N)
    shear : float16 (F, N / 2, N / 2, 2)
        Shear along x and y in disc radii, at the middles of squares of 2x2 cells; 0 outside the disc.
    """

    seen: Geometry
    pitch_px: float
    reference: U8
    frame: U8
    height: np.typing.NDArray[np.float16]
    contact: Bool
    shear: np.typing.NDArray[np.float16]

    @property
    def known(self) -> F32:
        """The maps of what is known of the sensor: float32 (6, N, N)."""
        return disc_map.geometry_maps(self.seen, self.pitch_px)


def training_model(seed: int) -> SensorModel:
    """Draw a sensor like `random_model`, but with wider ranges, so that sensors of `random_model` lie well inside."""
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
        drag_decay_mm=draw(2.0, 12.0),
        coulomb=math.exp(draw(math.log(0.8), math.log(10.0))),
        sway=draw(0.0, 0.6),
        bulge=draw(0.0, 0.9) if rng.random() < BULGING_PART else 0.0,
        pin_lag=draw(0.0, 0.4),
    )
    if rng.random() >= TACTIP_PART:
        return model
    tip = draw(0.18, 0.32)
    return replace(
        tactip(model), pin_length_pitches=draw(0.6, 1.4), pin_tip_radius_pitches=tip, pin_base_radius_pitches=tip
    )


def random_presses(model: SensorModel, rng: np.random.Generator) -> tuple[Press, ...]:
    """Draw up to three objects; their greatest depth is uniform up to 6.5 mm (on a skin of 20 mm)."""
    scale = model.skin_radius_mm / 20
    reach = 0.85 * model.skin_radius_mm * math.sin(math.radians(model.visible_half_angle_deg))
    target = float(rng.uniform(0.1, 6.5)) * scale
    presses: list[Press] = []
    for _ in range(int(rng.choice((1, 2, 3), p=(0.78, 0.15, 0.07)))):
        rho, angle = reach * rng.uniform() ** 0.6, rng.uniform(0, 2 * math.pi)
        x, y = rho * math.cos(angle), rho * math.sin(angle)
        size = float(rng.uniform(0.7, 1.3))
        depth = target - (0.0 if not presses else float(rng.uniform(0, 2)))
        presses.append(Press(random_shape(rng), x, y, depth, float(rng.uniform(0, 360)), size))
    return tuple(presses)


DrawPresses = Callable[[SensorModel, np.random.Generator], tuple[Press, ...]]


def random_drag(presses: Sequence[Press], model: SensorModel, rng: np.random.Generator) -> tuple[Press, ...]:
    """Drag objects by up to 5 mm (on a skin of 20 mm) and twist them, all in the same way or each differently."""
    scale, alike = model.skin_radius_mm / 20, rng.random() < 0.6
    dragged = []
    for k, press in enumerate(presses):
        if k == 0 or not alike:
            size, angle = float(rng.uniform(0, 5.0)) * scale, rng.uniform(0, 2 * math.pi)
            twist = float(np.clip(rng.normal(0, 6), -20, 20)) if rng.random() < 0.6 else 0.0
        dragged.append(
            replace(press, drag_x_mm=size * math.cos(angle), drag_y_mm=size * math.sin(angle), twist_deg=twist)
        )
    return tuple(dragged)


@dataclass(frozen=True, slots=True, eq=False)
class Unevenness:
    """How a sensor differs from the model.

    `stiffness`, over the skin's grid, multiplies the foundation's stiffness, and so does 1 + `hardening` h / (0.15 r).
    `skirt` holds the arguments of `with_skirt`. With `two_scales`, the skin is the other family's and uses none of
    these. `mechanics` determine how objects drag the skin.
    """

    stiffness: F32
    hardening: float
    skirt: tuple[float, float]
    renderer: Renderer
    two_scales: bool = False
    mechanics: Mechanics | None = None


def draw_unevenness(model: SensorModel, rng: np.random.Generator, wide: bool, varied: bool) -> Unevenness:
    """Draw a skin with uneven stiffness, another or a stretched lattice, and pins with a waist or a belly."""
    hardening = float(rng.uniform(-0.3, 2.5)) if wide and rng.random() < 0.6 else 0.0
    if varied:
        model = varied_model(model, rng)
    elif wide:
        model = replace(model, position_tolerance_mm=float(rng.uniform(0, 0.1)) * model.pitch_mm)
    n = undeformed(model.skin_radius_mm).height_mm.shape[0]
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


def uneven_skin(
    model: SensorModel, presses: Sequence[Press], unevenness: Unevenness, leaning_mm: F32 | None = None
) -> Skin:
    """Press a skin like `press_skin`, but on a foundation with uneven stiffness."""
    if unevenness.two_scales:
        return two_scale_skin(model, presses, leaning_mm)
    flat = undeformed(model.skin_radius_mm)
    floor = obstacle_of(model.skin_radius_mm, presses, leaning_mm)
    if not floor.any():
        return flat
    weight = mass_weight(model.skin_radius_mm, flat.step_mm, floor.shape[0] // 2)
    weight = weight * unevenness.stiffness * np.float32((flat.step_mm / model.skin_decay_mm) ** 2)
    window = window_of(floor > 0, 2 + math.ceil(9 * model.skin_decay_mm / flat.step_mm))
    inside, weight = np.ascontiguousarray(floor[window]), np.ascontiguousarray(weight[window])
    height = np.zeros_like(floor)
    height[window] = obstacle.solve(inside, weight)
    if unevenness.hardening:
        # One step towards the fixed point suffices, because any skirt on the way is as plausible.
        weight *= 1 + unevenness.hardening * np.minimum(height[window] / (0.15 * model.skin_radius_mm), 2)
        height[window] = obstacle.solve(inside, np.maximum(weight, np.float32(1e-4)))
    skin = with_skirt(Skin(model.skin_radius_mm, flat.step_mm, height, floor), *unevenness.skirt)
    return skin.leaning(leaning_mm)


def pressed_skin(
    model: SensorModel, unevenness: Unevenness, rng: np.random.Generator, draw: DrawPresses = random_presses
) -> tuple[Skin, tuple[Press, ...]]:
    """Press random objects into a skin, move them along z until they are about as deep as drawn, and drag them."""
    while True:
        presses = draw(model, rng)
        target = max(p.depth_mm for p in presses)
        try:
            depth = 0.0
            for _ in range(2):
                found = float(obstacle_of(model.skin_radius_mm, presses).max())
                if abs(found - target) < 0.3 * target or found == 0:
                    depth = found
                    break
                presses = tuple(replace(p, depth_mm=p.depth_mm + target - found) for p in presses)
            if not 0 < depth < 7.5 * model.skin_radius_mm / 20:
                continue
            if rng.random() > UNDRAGGED_PART:
                presses = random_drag(presses, model, rng)
            shape = functools.partial(uneven_skin, model, presses, unevenness)
            return drag_skin(shape, model, presses, unevenness.mechanics), presses
        except ValueError:
            continue


def spoil(image: U8, disc: Disc, rng: np.random.Generator) -> U8:
    """Add nuisances that the daemon tolerates: other light, an aged LED, a shift by a pixel, noise, glare, dust."""
    if rng.random() < 0.6:
        image = nuisance.gain(image, float(rng.uniform(0.8, 1.2)))
    if rng.random() < 0.2:
        loss, angle = float(rng.uniform(0, 0.3)), float(rng.uniform(0, 360))
        image = camera_faults.uneven(image, disc.row_c, disc.col_c, disc.radius_px, loss, angle)
    if rng.random() < 0.15:
        for _ in range(int(rng.integers(1, 4))):
            rho, angle = disc.radius_px * math.sqrt(rng.uniform(0, 0.9)), rng.uniform(0, 2 * math.pi)
            row, col = disc.row_c + rho * math.sin(angle), disc.col_c + rho * math.cos(angle)
            image = camera_faults.speck(image, row, col, disc.radius_px * float(rng.uniform(0.008, 0.05)))
    if rng.random() < 0.3:
        image = nuisance.shift(image, int(rng.integers(-1, 2)), int(rng.integers(-1, 2)))
    if rng.random() < 0.2:
        image = camera_faults.noise(image, float(rng.uniform(1, 7)), int(rng.integers(1 << 30)))
    if rng.random() < 0.15:
        rho, angle = disc.radius_px * rng.uniform(0, 0.9), rng.uniform(0, 2 * math.pi)
        row, col = disc.row_c + rho * math.sin(angle), disc.col_c + rho * math.cos(angle)
        image = camera_faults.glare(image, row, col, disc.radius_px * float(rng.uniform(0.01, 0.04)))
    return image


def white_map(image: U8, mask: U8, disc: Disc, pitch_px: float) -> F32:
    """Compute the share of white in each cell, 0 to 1."""
    integrator = Integrator(Window(0, 0, *mask.shape), 0)
    white = binarise(greyscale.to_grey(image), mask, "adaptive", pitch_px)
    return CellMeans(integrator, disc_map.map_grid(disc)).means(integrator.integrate(white))


def within(disc: Disc, rows: F64, cols: F64) -> Bool:
    """Whether each pixel lies in a circle."""
    return np.asarray(np.hypot(rows - disc.row_c, cols - disc.col_c) <= disc.radius_px)


def true_shear(skin: Skin, model: SensorModel, seen: Disc) -> F32:
    """Compute shear in disc radii in the middle of each square of 2x2 cells of the calibrated disc `seen`."""
    grid, geometry = disc_map.map_grid(seen, N // 2), model.geometry
    rows = np.repeat(grid.row0 + grid.step_px * np.arange(N // 2), N // 2)
    cols = np.tile(grid.col0 + grid.step_px * np.arange(N // 2), N // 2)
    inside = within(geometry.disc, rows, cols) & within(seen, rows, cols)
    shear = np.zeros((N * N // 4, 2), np.float32)
    if skin.height_mm.any():
        shear[inside] = shear_mm(skin, skin_points(skin, geometry, rows[inside], cols[inside]), model.friction)
    unit_mm = geometry.skin_radius_mm * math.sin(math.radians(geometry.visible_half_angle_deg))
    return (shear / np.float32(unit_mm)).reshape(N // 2, N // 2, 2)


def true_maps(skin: Skin, presses: Sequence[Press], geometry: Geometry, seen: Disc) -> tuple[F32, Bool]:
    """Compute h in disc radii (mm over r sinθ) and contact in the middle of each cell of the calibrated disc `seen`."""
    grid = disc_map.map_grid(seen)
    rows = np.repeat(grid.row0 + grid.step_px * np.arange(N), N)
    cols = np.tile(grid.col0 + grid.step_px * np.arange(N), N)
    disc = geometry.disc
    inside = within(disc, rows, cols) & within(seen, rows, cols)
    height, contact = np.zeros(N * N, np.float32), np.zeros(N * N, bool)
    if skin.height_mm.any():
        points = skin_points(skin, geometry, rows[inside], cols[inside])
        h = np.maximum(skin.radius_mm - np.linalg.norm(points, axis=1), 0)
        height[inside] = h
        if presses:
            contact[inside] = np.abs(distance_mm(presses, skin.radius_mm, points)) <= CONTACT_TOLERANCE_MM
    unit_mm = geometry.skin_radius_mm * math.sin(math.radians(geometry.visible_half_angle_deg))
    return (height / unit_mm).reshape(N, N), contact.reshape(N, N)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A calibrated sensor: `seen` is its geometry as calibration found it, `reference` its white at rest."""

    renderer: Renderer
    camera: Camera
    seen: Geometry
    mask: U8
    pitch_px: float
    reference: U8

    def white(self, image: U8) -> U8:
        """Compute the white of a frame in each cell, 0 to 255."""
        return np.rint(255 * white_map(image, self.mask, self.seen.disc, self.pitch_px)).astype(np.uint8)


def calibrated(renderer: Renderer, camera_of: Camera, rng: np.random.Generator, circle: float = 1.0) -> View | None:
    """Take a sensor's reference; None if it shows no pattern for calibration. `circle` comes from `found_circle`."""
    model = renderer.model
    clean = renderer.draw(undeformed(model.skin_radius_mm))
    images = [camera_of(renderer.expose(clean, int(rng.integers(1 << 30)))) for _ in range(int(rng.choice((1, 3, 6))))]
    disc = replace(
        model.geometry.disc,
        row_c=model.row_c + float(rng.normal(0, 0.3)),
        col_c=model.col_c + float(rng.normal(0, 0.3)),
        radius_px=model.disc_radius_px * circle * (1 + float(rng.normal(0, 0.003))),
    )
    try:
        pitch_px = pattern.marker_pitch_px(pattern.mean_image([greyscale.to_grey(i) for i in images]), disc)
    except ConfigError:
        return None
    mask = disc_mask(model.image_height_px, model.image_width_px, disc).astype(np.uint8)
    reference = np.mean([white_map(i, mask, disc, pitch_px) for i in images], axis=0)
    seen = replace(model.geometry, disc=disc)
    return View(renderer, camera_of, seen, mask, pitch_px, np.rint(255 * reference).astype(np.uint8))


def random_skin(
    model: SensorModel, unevenness: Unevenness, rng: np.random.Generator, draw: DrawPresses = random_presses
) -> tuple[Skin, tuple[Press, ...]]:
    """Draw the skin of a frame: pressed, at rest, or with the dent after a release."""
    kind = rng.random()
    if kind < UNLOADED_PART:
        return undeformed(model.skin_radius_mm), ()
    skin, presses = pressed_skin(model, unevenness, rng, draw)
    return (left_over(skin, float(rng.uniform(0, 0.1))), ()) if kind > 1 - RELEASED_PART else (skin, presses)


def samples_of(view: View, skins: Iterable[tuple[Skin, tuple[Press, ...]]], rng: np.random.Generator) -> Samples:
    """Make the samples that a sensor takes of these skins."""
    model, disc = view.renderer.model, view.seen.disc
    maps, heights, contacts, shears = [], [], [], []
    for skin, presses in skins:
        image = view.renderer.expose(view.renderer.draw(skin), int(rng.integers(1 << 30)))
        if rng.random() < NUISANCE_PART:
            image = spoil(image, disc, rng)
        height, contact = true_maps(skin, presses, model.geometry, disc)
        maps.append(view.white(view.camera(image)))
        heights.append(height.astype(np.float16))
        contacts.append(contact)
        shears.append(true_shear(skin, model, disc).astype(np.float16))
    return Samples(
        seen=view.seen,
        pitch_px=view.pitch_px,
        reference=view.reference,
        frame=np.stack(maps),
        height=np.stack(heights),
        contact=np.stack(contacts),
        shear=np.stack(shears),
    )


def sensor_samples(seed: int, frames: int) -> list[Samples]:
    """Make the samples of `VIEWS` sensors that see the same skins; they use this seed and the following ones.

    Skins take three quarters of the time of a frame. A sensor whose reference shows no pattern gives no samples.
    """
    return outside_samples(seed, frames) if seed >= OUTSIDE_FROM else usual_samples(seed, frames)


def usual_samples(seed: int, frames: int) -> list[Samples]:
    """Make samples of the kinds before `outside`; all sensors have the first one's dome."""
    rng = np.random.default_rng((seed, 12))
    family = other_model if seed >= OTHER_FROM else training_model
    dome = family(seed)
    unevenness, views = [], []
    for k in range(VIEWS):
        own = rng if k == 0 else np.random.default_rng((seed + k, 12))
        unevenness.append(drawn_unevenness(on_dome(family(seed + k), dome), seed, own))
        views.append(calibrated(unevenness[k].renderer, lambda image: image, own))
    if not any(views):
        return []
    skins = [random_skin(dome, unevenness[0], rng) for _ in range(frames)]
    return [samples_of(view, skins, rng) for view in views if view is not None]


def drawn_unevenness(model: SensorModel, seed: int, rng: np.random.Generator) -> Unevenness:
    """Draw how a sensor of the seed's kind differs from its model."""
    if seed >= OTHER_FROM:
        renderer = VariedRenderer(model, lattice_print(model, 90.0), CAPS)
        return Unevenness(EVEN, 0.0, (0.0, 1.0), renderer, two_scales=True, mechanics=TURNING)
    if seed >= UNEVEN_FROM:
        return draw_unevenness(model, rng, seed >= WIDE_FROM, seed >= VARIED_FROM)
    return Unevenness(EVEN, 0.0, (0.0, 1.0), Renderer(model))


def outside_samples(seed: int, frames: int) -> list[Samples]:
    """Make samples of the kind `outside`."""
    rng = np.random.default_rng((seed, 12))
    dome = soft_dome(seed)
    views = []
    for k in range(VIEWS):
        own = np.random.default_rng((seed + k, 23))
        renderer = OutsideRenderer(printed(dome, seed + k), own)
        views.append(calibrated(renderer, camera(rng), rng, found_circle(renderer.printed_part, own)))
    if not any(views):
        return []
    uneven = draw_unevenness(dome, rng, wide=True, varied=True)
    turning = rng.random() < 0.3
    uneven = replace(uneven, two_scales=rng.random() < 0.25, mechanics=TURNING if turning else None)
    skins = [random_skin(dome, uneven, rng, outside_presses) for _ in range(frames)]
    return [samples_of(view, skins, rng) for view in views if view is not None]


EVEN = np.ones((1, 1), np.float32)

cv2.setNumThreads(1)
