"""Make the training samples of a simulated sensor:
random sensor, random presses, nuisances, maps.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.calibration.reference import pattern
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.fitting.skins import (
    NUISANCE_PART,
    Unevenness,
    disturbed,
    random_skin,
    true_maps,
    true_shear,
    wide_presses,
)
from tacshade_edge.lab.fitting.twin import on_dome
from tacshade_edge.lab.simulator.drag import TURNING
from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.render import CAP, PinProfile, Renderer, print_features
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model, tactip
from tacshade_edge.lab.simulator.skin import Skin, undeformed
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import Window, disc_mask
from tacshade_edge.sensor.image import greyscale
from tacshade_edge.sensor.image.white import CellMeans, Integrator, binarise
from tacshade_edge.types import F32, U8, Bool, Disc, Geometry
from tools.testbed.simulator.families import lattice_print, other_model
from tools.training.outside import (
    VIEWS,
    Camera,
    OutsideRenderer,
    camera,
    found_circle,
    printed,
    soft_dome,
)
from tools.training.varied import pin_outline, varied_model, varied_print

TACTIP_PART, SMALL_PART, ORTHOGRAPHIC_PART, BULGING_PART = 0.12, 0.15, 0.06, 0.4

UNEVEN_FROM = 200_000
"""From this seed on, sensors also have skins with uneven stiffness, pins with a waist or a belly,
and lattices that are stretched, or skewed with one marker per cell, so that the network trusts no
skirt, pin or lattice too much.
"""

WIDE_FROM = 300_000
"""From this seed on, sensors are more uneven, their skins stiffen (or soften) under load,
and marks are misplaced.
"""

VARIED_FROM = 400_000
"""From this seed on, sensors also have the features of `varied`."""

OTHER_FROM = 550_000
"""From this seed on, sensors belong to the family that evaluate.py calls "other"."""

OUTSIDE_FROM = 650_000
"""From this seed on, sensors are those of `outside`."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """F frames of one sensor as the network sees them (N, N),
    and the geometry that calibration found.

    `height` is h in disc radii, `shear` (F, N / 2, N / 2, 2) along x and y in disc radii at the
    middles of squares of 2x2 cells; both are 0 outside the disc.
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
    """Draw a sensor like `random_model`, but with wider ranges,
    so that sensors of `random_model` lie well inside.
    """
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
        tactip(model),
        pin_length_pitches=draw(0.6, 1.4),
        pin_tip_radius_pitches=tip,
        pin_base_radius_pitches=tip,
    )


def draw_unevenness(
    model: SensorModel, rng: np.random.Generator, wide: bool, varied: bool
) -> tuple[Unevenness, Renderer]:
    """Draw a skin with uneven stiffness, another or a stretched lattice,
    and pins with a waist or a belly.
    """
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
        renderer = Renderer(model, varied_print(model, rng), pin_outline(rng))
        return Unevenness(stiffness, hardening, skirt), renderer
    if wide:
        profile = PinProfile.waist(float(rng.uniform(0.2, 0.85)), float(rng.uniform(0.6, 1.25)))
    else:
        profile = PinProfile.waist(float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.75, 1.15)))
    if rng.random() < 0.5:
        steepest, longest = (82.0, 1.25) if wide else (78.0, 1.2)
        marks = lattice_print(
            model, float(rng.uniform(55, steepest)), float(rng.uniform(1.0, longest))
        )
    else:
        marks = print_features(model)
        angle, longer = rng.uniform(0, math.pi), rng.uniform(1.0, 1.13)
        axis = np.array((math.cos(angle), math.sin(angle)))
        stretch = (np.eye(2) + np.outer(axis, axis) * (longer - 1)) / math.sqrt(longer)
        marks = replace(
            marks,
            marker_chart_mm=marks.marker_chart_mm @ stretch,
            pin_chart_mm=marks.pin_chart_mm @ stretch,
        )
    return Unevenness(stiffness, hardening), Renderer(model, marks, profile)


def white_map(image: U8, mask: U8, disc: Disc, pitch_px: float) -> F32:
    """Compute the share of white in each cell, 0 to 1."""
    integrator = Integrator(Window(0, 0, *mask.shape), 0)
    white = binarise(greyscale.to_grey(image), mask, "adaptive", pitch_px)
    return CellMeans(integrator, disc_map.map_grid(disc)).means(integrator.integrate(white))


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A calibrated sensor: `seen` is its geometry as calibration found it,
    `reference` its white at rest.
    """

    renderer: Renderer
    camera: Camera
    seen: Geometry
    mask: U8
    pitch_px: float
    reference: U8

    def white(self, image: U8) -> U8:
        """Compute the white of a frame in each cell, 0 to 255."""
        return np.rint(255 * white_map(image, self.mask, self.seen.disc, self.pitch_px)).astype(
            np.uint8
        )


def calibrated(
    renderer: Renderer, camera_of: Camera, rng: np.random.Generator, circle: float = 1.0
) -> View | None:
    """Take a sensor's reference; None if it shows no pattern for calibration.

    `circle` comes from `found_circle`.
    """
    model = renderer.model
    clean = renderer.draw(undeformed(model.skin_radius_mm))
    images = [
        camera_of(renderer.expose(clean, int(rng.integers(1 << 30))))
        for _ in range(int(rng.choice((1, 3, 6))))
    ]
    disc = replace(
        model.geometry.disc,
        row_c=model.row_c + float(rng.normal(0, 0.3)),
        col_c=model.col_c + float(rng.normal(0, 0.3)),
        radius_px=model.disc_radius_px * circle * (1 + float(rng.normal(0, 0.003))),
    )
    try:
        pitch_px = pattern.marker_pitch_px(
            pattern.mean_image([greyscale.to_grey(i) for i in images]), disc
        )
    except ConfigError:
        return None
    mask = disc_mask(model.image_height_px, model.image_width_px, disc).astype(np.uint8)
    reference = np.mean([white_map(i, mask, disc, pitch_px) for i in images], axis=0)
    seen = replace(model.geometry, disc=disc)
    return View(
        renderer, camera_of, seen, mask, pitch_px, np.rint(255 * reference).astype(np.uint8)
    )


def samples_of(
    view: View, skins: Iterable[tuple[Skin, tuple[Press, ...]]], rng: np.random.Generator
) -> Samples:
    """Make the samples that a sensor takes of these skins."""
    model, disc = view.renderer.model, view.seen.disc
    maps, heights, contacts, shears = [], [], [], []
    for skin, presses in skins:
        image = view.renderer.expose(view.renderer.draw(skin), int(rng.integers(1 << 30)))
        if rng.random() < NUISANCE_PART:
            image = disturbed(image, disc, rng)
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
    """Make the samples of `VIEWS` sensors that see the same skins;
    they use this seed and the following ones.

    Skins take three quarters of the time of a frame.
    A sensor whose reference shows no pattern gives no samples.
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
        views.append(calibrated(unevenness[k][1], lambda image: image, own))
    if not any(views):
        return []
    skins = [random_skin(dome, unevenness[0][0], rng) for _ in range(frames)]
    return [samples_of(view, skins, rng) for view in views if view is not None]


def drawn_unevenness(
    model: SensorModel, seed: int, rng: np.random.Generator
) -> tuple[Unevenness, Renderer]:
    """Draw how a sensor of the seed's kind differs from its model."""
    if seed >= OTHER_FROM:
        renderer = Renderer(model, lattice_print(model, 90.0), CAP)
        return Unevenness(two_scales=True, mechanics=TURNING), renderer
    if seed >= UNEVEN_FROM:
        return draw_unevenness(model, rng, seed >= WIDE_FROM, seed >= VARIED_FROM)
    return Unevenness(), Renderer(model)


def outside_samples(seed: int, frames: int) -> list[Samples]:
    """Make samples of the kind `outside`."""
    rng = np.random.default_rng((seed, 12))
    dome = soft_dome(seed)
    views = []
    for k in range(VIEWS):
        own = np.random.default_rng((seed + k, 23))
        renderer = OutsideRenderer(printed(dome, seed + k), own)
        views.append(
            calibrated(renderer, camera(rng), rng, found_circle(renderer.printed_part, own))
        )
    if not any(views):
        return []
    uneven, _ = draw_unevenness(dome, rng, wide=True, varied=True)
    turning = rng.random() < 0.3
    uneven = replace(uneven, two_scales=rng.random() < 0.25, mechanics=TURNING if turning else None)
    skins = [random_skin(dome, uneven, rng, wide_presses) for _ in range(frames)]
    return [samples_of(view, skins, rng) for view in views if view is not None]


cv2.setNumThreads(1)


KINDS = ("plain", "uneven", "wide", "varied", "other", "outside")
"""In shards from 0, 5000, 10000, 15000, 20000 and 25000 on."""

SHARES = (8, 2, 2, 3, 4, 6)
SHARDS_OF_A_KIND = 5000


def shards(number: int) -> list[int]:
    """List the first shards to make; the first N of them hold the kinds in `SHARES`, whatever N."""
    places = [
        ((k + 0.5) / share, SHARDS_OF_A_KIND * kind + k)
        for kind, share in enumerate(SHARES)
        for k in range(number)
    ]
    return [shard for _, shard in sorted(places)[:number]]


def kind_of(shard: int) -> str:
    """Name the kind of a shard's sensors."""
    return KINDS[shard // SHARDS_OF_A_KIND]
