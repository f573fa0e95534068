"""Random skins for training: objects that press and drag, disturbed pictures, and the true maps."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.lab.fitting import compiled
from tacshade_edge.lab.fitting.shapes import random_shape
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.drag import DragMechanics, drag_skin, leant_mm, two_scale_skin
from tacshade_edge.lab.simulator.press import Press, Shape, distance_mm
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import (
    Skin,
    left_over,
    mass_weight,
    obstacle_of,
    undeformed,
    window_of,
)
from tacshade_edge.lab.simulator.truth import CONTACT_TOLERANCE_MM
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.types import F32, F64, U8, Bool, Disc, Geometry

N = disc_map.CELLS
# Rest and the dent after a release must not be felt, so both are seen; more of them would take away
# from what is measured.
UNLOADED_PART, RELEASED_PART, UNDRAGGED_PART, NUISANCE_PART = 0.04, 0.04, 0.3, 0.5
PLATE_PART = 0.5
MEMBRANE = DragMechanics(leant_mm, compiled.carry)
"""`lab.simulator.drag.MEMBRANE`, compiled."""

DrawPresses = Callable[[SensorModel, np.random.Generator], tuple[Press, ...]]


def random_presses(model: SensorModel, rng: np.random.Generator) -> tuple[Press, ...]:
    """Draw up to three objects; their greatest depth is uniform up to 6.5 mm
    (on a skin of 20 mm).
    """
    scale = model.skin_radius_mm / 20
    reach = 0.85 * model.skin_radius_mm * math.sin(math.radians(model.visible_half_angle_deg))
    # Deeper than users press, so that the depths in use do not lie at the edge of what was seen.
    target = float(rng.uniform(0.1, 6.5)) * scale
    presses: list[Press] = []
    for _ in range(int(rng.choice((1, 2, 3), p=(0.78, 0.15, 0.07)))):
        # Between evenly over the area (0.5) and over the radius (1): denser in the middle.
        rho, angle = reach * rng.uniform() ** 0.6, rng.uniform(0, 2 * math.pi)
        x, y = rho * math.cos(angle), rho * math.sin(angle)
        size = float(rng.uniform(0.7, 1.3))
        depth = target - (0.0 if not presses else float(rng.uniform(0, 2)))
        presses.append(Press(random_shape(rng), x, y, depth, float(rng.uniform(0, 360)), size))
    return tuple(presses)


def wide_presses(model: SensorModel, rng: np.random.Generator) -> tuple[Press, ...]:
    """Draw a plate wider than the dome, perhaps with an edge, tilted by up to 25 degrees;
    or a random object.
    """
    scale = model.skin_radius_mm / 20
    reach = 0.8 * model.skin_radius_mm * math.sin(math.radians(model.visible_half_angle_deg))
    target = float(rng.uniform(0.2, 6.5)) * scale
    if rng.random() < PLATE_PART:
        return (Press(_plate(rng, reach), 0.0, 0.0, target, float(rng.uniform(0, 360))),)
    rho, angle = reach * rng.uniform() ** 0.6, rng.uniform(0, 2 * math.pi)
    size = float(rng.uniform(0.8, 2.0))
    x, y = rho * math.cos(angle), rho * math.sin(angle)
    return (Press(random_shape(rng), x, y, target, float(rng.uniform(0, 360)), size),)


def _plate(rng: np.random.Generator, reach: float) -> Shape:
    """Draw a plate: everything above a tilted plane, cut off along up to two lines."""
    # The root: evenly over the directions of the normal.
    tilt = math.radians(25.0) * math.sqrt(rng.uniform())
    normal = np.array((math.sin(tilt), 0.0, math.cos(tilt)))
    cuts: list[tuple[float, float, float]] = []
    for _ in range(int(rng.choice((0, 1, 2), p=(0.6, 0.3, 0.1)))):
        angle, far = rng.uniform(0, 2 * math.pi), float(rng.uniform(-0.5, 0.8)) * reach
        cuts.append((math.cos(angle), math.sin(angle), max(far, 1.0) if cuts else far))

    def sdf(p: F64) -> F64:
        distance = -(p @ normal.astype(p.dtype))
        for c, s, far in cuts:
            distance = np.maximum(distance, c * p[:, 0] + s * p[:, 1] - far)
        return np.asarray(distance)

    return Shape("plate", sdf)


def random_drag(
    presses: Sequence[Press], model: SensorModel, rng: np.random.Generator
) -> tuple[Press, ...]:
    """Drag objects by up to 5 mm (on a skin of 20 mm) and twist them,
    all in the same way or each differently.
    """
    # A hand moves everything it holds; two fingers do not.
    scale, alike = model.skin_radius_mm / 20, rng.random() < 0.6
    dragged = []
    for k, press in enumerate(presses):
        if k == 0 or not alike:
            size, angle = float(rng.uniform(0, 5.0)) * scale, rng.uniform(0, 2 * math.pi)
            twist = float(np.clip(rng.normal(0, 6), -20, 20)) if rng.random() < 0.6 else 0.0
        dragged.append(
            replace(
                press,
                drag_x_mm=size * math.cos(angle),
                drag_y_mm=size * math.sin(angle),
                twist_deg=twist,
            )
        )
    return tuple(dragged)


@dataclass(frozen=True, slots=True, eq=False)
class Unevenness:
    """How a skin differs from the model.

    `stiffness`, one number or one for each node, multiplies the foundation's, and so does 1 +
    `hardening` h / (0.15 r). `skirt` holds the arguments of `with_skirt`. With `two_scales`, the
    skin is that of `lab.simulator.drag.two_scale_skin` and uses none of these. `mechanics`
    determine how objects drag the skin.
    """

    stiffness: F32 | float = 1.0
    hardening: float = 0.0
    skirt: tuple[float, float] = (0.0, 1.0)
    two_scales: bool = False
    mechanics: DragMechanics | None = None


def uneven_skin(
    model: SensorModel,
    presses: Sequence[Press],
    unevenness: Unevenness,
    leaning_mm: F32 | None = None,
) -> Skin:
    """Press a skin like `press_skin`, but on a foundation with uneven stiffness."""
    if unevenness.two_scales:
        return two_scale_skin(model, presses, leaning_mm, compiled.solve)
    flat = undeformed(model.skin_radius_mm)
    # On domes only: a fit simulates no twin of a flat skin.
    floor = obstacle_of(model.skin_radius_mm, presses, leaning_mm)
    # Objects that do not reach the skin leave it as it is.
    if not floor.any():
        return flat
    weight = mass_weight(model.skin_radius_mm, flat.step_mm, floor.shape[0] // 2)
    weight = weight * unevenness.stiffness * np.float32((flat.step_mm / model.skin_decay_mm) ** 2)
    window = window_of(floor > 0, 2 + math.ceil(9 * model.skin_decay_mm / flat.step_mm))
    inside, weight = np.ascontiguousarray(floor[window]), np.ascontiguousarray(weight[window])
    height = np.zeros_like(floor)
    height[window] = compiled.solve(inside, weight)
    if unevenness.hardening:
        # One step towards the fixed point suffices, because any skirt on the way is as plausible.
        weight *= 1 + unevenness.hardening * np.minimum(
            height[window] / (0.15 * model.skin_radius_mm), 2
        )
        height[window] = compiled.solve(inside, np.maximum(weight, np.float32(1e-4)))
    skin = with_skirt(Skin(model.skin_radius_mm, flat.step_mm, height, floor), *unevenness.skirt)
    return skin.leaning(leaning_mm)


def with_skirt(skin: Skin, part: float, reach_mm: float) -> Skin:
    """Spread the skirt: blur part of h over some mm,
    because a soft depth pulls its surroundings down.
    """
    if part == 0 or not skin.height_mm.any():
        return skin
    spread = cv2.GaussianBlur(
        skin.height_mm, (0, 0), reach_mm / skin.step_mm, borderType=cv2.BORDER_CONSTANT
    )
    # The blur must not push the skin into the object.
    height = np.maximum((1 - part) * skin.height_mm + part * spread, skin.obstacle_mm)
    return replace(skin, height_mm=np.asarray(height, np.float32))


def pressed_skin(
    model: SensorModel,
    unevenness: Unevenness,
    rng: np.random.Generator,
    draw: DrawPresses = random_presses,
) -> tuple[Skin, tuple[Press, ...]]:
    """Press random objects into a skin, move them along z until they are about as deep as drawn,
    and drag them.
    """
    while True:
        presses = draw(model, rng)
        target = max(p.depth_mm for p in presses)
        try:
            depth = 0.0
            # The depth that was drawn is that of one object on its own; several, or one at the
            # side, reach less deep or deeper.
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
            return drag_skin(shape, model, presses, unevenness.mechanics or MEMBRANE), presses
        # An object that is not over the skin, or reaches the middle: draw again.
        except ValueError:
            continue


def random_skin(
    model: SensorModel,
    unevenness: Unevenness,
    rng: np.random.Generator,
    draw: DrawPresses = random_presses,
) -> tuple[Skin, tuple[Press, ...]]:
    """Draw the skin of a frame: pressed, at rest, or with the dent after a release."""
    kind = rng.random()
    if kind < UNLOADED_PART:
        return undeformed(model.skin_radius_mm), ()
    skin, presses = pressed_skin(model, unevenness, rng, draw)
    return (
        (left_over(skin, float(rng.uniform(0, 0.1))), ())
        if kind > 1 - RELEASED_PART
        else (skin, presses)
    )


def disturbed(image: U8, disc: Disc, rng: np.random.Generator) -> U8:
    """Add nuisances that the daemon tolerates: other light, an aged LED, a shift by a pixel, noise,
    glare, dust.
    """
    if rng.random() < 0.6:
        image = camera_faults.gain(image, float(rng.uniform(0.8, 1.2)))
    if rng.random() < 0.2:
        loss, angle = float(rng.uniform(0, 0.3)), float(rng.uniform(0, 360))
        image = camera_faults.uneven(image, disc.row_c, disc.col_c, disc.radius_px, loss, angle)
    if rng.random() < 0.15:
        for _ in range(int(rng.integers(1, 4))):
            rho, angle = (
                disc.radius_px * math.sqrt(rng.uniform(0, 0.9)),
                rng.uniform(0, 2 * math.pi),
            )
            row, col = disc.row_c + rho * math.sin(angle), disc.col_c + rho * math.cos(angle)
            image = camera_faults.speck(
                image, row, col, disc.radius_px * float(rng.uniform(0.008, 0.05))
            )
    if rng.random() < 0.3:
        image = camera_faults.shift(image, int(rng.integers(-1, 2)), int(rng.integers(-1, 2)))
    if rng.random() < 0.2:
        image = camera_faults.noise(image, float(rng.uniform(1, 7)), int(rng.integers(1 << 30)))
    if rng.random() < 0.15:
        rho, angle = disc.radius_px * rng.uniform(0, 0.9), rng.uniform(0, 2 * math.pi)
        row, col = disc.row_c + rho * math.sin(angle), disc.col_c + rho * math.cos(angle)
        image = camera_faults.glare(
            image, row, col, disc.radius_px * float(rng.uniform(0.01, 0.04))
        )
    return image


def true_maps(
    skin: Skin, presses: Sequence[Press], geometry: Geometry, seen: Disc
) -> tuple[F32, Bool]:
    """Compute h in disc radii (mm over r sinθ) and contact in the middle of each cell
    of the calibrated disc `seen`.
    """
    grid = disc_map.map_grid(seen)
    rows = np.repeat(grid.row0 + grid.step_px * np.arange(N), N)
    cols = np.tile(grid.col0 + grid.step_px * np.arange(N), N)
    disc = geometry.disc
    # `seen` is where the calibration says that the circle is, `disc` where it is: they differ a
    # little, as in life.
    inside = within(disc, rows, cols) & within(seen, rows, cols)
    height, contact = np.zeros(N * N, np.float32), np.zeros(N * N, bool)
    if skin.height_mm.any():
        points = compiled.skin_points(skin, geometry, rows[inside], cols[inside])
        h = np.maximum(skin.radius_mm - np.linalg.norm(points, axis=1), 0)
        height[inside] = h
        if presses:
            contact[inside] = (
                np.abs(distance_mm(presses, skin.radius_mm, points)) <= CONTACT_TOLERANCE_MM
            )
    unit_mm = geometry.skin_radius_mm * math.sin(math.radians(geometry.visible_half_angle_deg))
    return (height / unit_mm).reshape(N, N), contact.reshape(N, N)


def true_shear(skin: Skin, model: SensorModel, seen: Disc) -> F32:
    """Compute shear in disc radii in the middle of each square of 2x2 cells
    of the calibrated disc `seen`.
    """
    grid, geometry = disc_map.map_grid(seen, N // 2), model.geometry
    rows = np.repeat(grid.row0 + grid.step_px * np.arange(N // 2), N // 2)
    cols = np.tile(grid.col0 + grid.step_px * np.arange(N // 2), N // 2)
    inside = within(geometry.disc, rows, cols) & within(seen, rows, cols)
    # At half the resolution, which is that of the networks for shear.
    shear = np.zeros((N * N // 4, 2), np.float32)
    if skin.height_mm.any():
        shear[inside] = compiled.shear_mm(
            skin, compiled.skin_points(skin, geometry, rows[inside], cols[inside]), model.friction
        )
    unit_mm = geometry.skin_radius_mm * math.sin(math.radians(geometry.visible_half_angle_deg))
    return (shear / np.float32(unit_mm)).reshape(N // 2, N // 2, 2)


def within(disc: Disc, rows: F64, cols: F64) -> Bool:
    """Whether each pixel lies in a circle."""
    return np.asarray(np.hypot(rows - disc.row_c, cols - disc.col_c) <= disc.radius_px)
