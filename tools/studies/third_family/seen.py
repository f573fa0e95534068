"""Turn the mesh's points into a skin on the simulator's grid, from which the simulator draws frames and the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CloughTocher2DInterpolator

from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.press import Press, distance_mm
from tacshade_edge.simulator.prints import PinProfile, lattice_print
from tacshade_edge.simulator.render import Renderer
from tacshade_edge.simulator.skin import Skin, direction_to_chart, undeformed
from tacshade_edge.simulator.truth import Truth, measure, skin_points
from tacshade_edge.types import F64

TOUCHING_MM = 0.06
"""Skin nearer to the object than this counts as touching, because it lies this far off between touching mesh points."""


def deformed(radius_mm: float, rest_mm: F64, at_mm: F64) -> Skin:
    """Make a smooth skin through mesh points (N, 3), given their places at rest and now.

    `Skin.origin_mm` contains the material's whole motion, so the model's `friction` must be 0.
    """
    flat = undeformed(radius_mm)
    n = len(flat.height_mm) // 2
    axis = np.arange(-n, n + 1) * flat.step_mm
    x, y = np.meshgrid(axis, axis)
    now, before = (np.stack(direction_to_chart(points, radius_mm), axis=-1) for points in (at_mm, rest_mm))
    values = np.column_stack((radius_mm - np.linalg.norm(at_mm, axis=1), before - now))
    smooth = np.nan_to_num(CloughTocher2DInterpolator(now, values)(x, y)).astype(np.float32)
    return replace(
        flat,
        height_mm=smooth[..., 0],
        # No part of this skin leans, but a map of zeros allows contact where the skin has moved outwards.
        leaning_mm=np.zeros_like(flat.height_mm),
        origin_mm=smooth[..., 1:],
    )


def seen_truth(skin: Skin, presses: Sequence[Press], model: SensorModel) -> Truth:
    """Measure the truth; skin inside an object also counts as touching, because MuJoCo's contact yields a little."""
    truth = measure(skin, presses, model.geometry, (model.image_height_px, model.image_width_px))
    rows, cols = np.nonzero(np.isfinite(truth.height_mm))
    points = skin_points(skin, model.geometry, rows.astype(float), cols.astype(float))
    touching = distance_mm(presses, skin.radius_mm, points) <= TOUCHING_MM
    contact = np.zeros_like(truth.contact)
    contact[rows[touching], cols[touching]] = True
    return replace(truth, contact=contact, points_mm=points[touching].astype(np.float32))


def renderer(model: SensorModel, seed: int) -> Renderer:
    """Draw a print: on the hexagonal or another lattice, with frusta, caps or pins with a waist."""
    rng = np.random.default_rng((seed, 43))
    marks = None if rng.random() < 0.5 else lattice_print(model, float(rng.uniform(60, 90)))
    kind = int(rng.integers(3))
    profile = (PinProfile(()), PinProfile(((1.0, 0.7, 0.0),)), PinProfile.waist(0.5, float(rng.uniform(0.7, 0.9))))[
        kind
    ]
    return Renderer(model, marks, profile)
