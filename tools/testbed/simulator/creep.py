"""Creep and recovery of the skin, as a standard linear solid.

The solid is a spring in series with a parallel spring and dashpot (Zener, Elasticity and Anelasticity of Metals, 1948;
Findley, Lai and Onaran, Creep and Relaxation of Nonlinear Viscoelastic Materials, 1976, ch. 5). With u the immediate
deformation under a load, the second spring's e follows τ e' = c u - e, so that

    e(t) = c/τ ∫ u(s) exp(-(t - s)/τ) ds.

Under a constant load, u grows to u (1 + c (1 - exp(-t/τ))). After the load is gone, e remains and decays by
exp(-t/τ), from at most c / (1 + c) of the depth. Membrane and foundation of the skin are assumed to be the same solid.
Then e is a shape without forces, and contact with the skin is elastic contact with a skin of this shape: the
correspondence of Lee and Radok (J. Appl. Mech. 27, 1960), here for any history. Along the skin, u is an object's drag,
of which the motion is given instead of the load; this causes a relative difference of c².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.simulator.skin import Skin, undeformed
from tacshade_edge.types import F32, F64

_INVERSE_STEPS = 24


def kept(times_s: Sequence[float], t_s: float, creep_part: float, creep_s: float) -> F64:
    """Compute the weights (K,) of a history's knots: e(t) is the weighted sum of u at the knots; `creep_part` is c.

    u is linear between two knots, and 0 before the first and after the last. Weights are at least 0, and their sum is
    at most `creep_part`.
    """
    times, weights = np.asarray(times_s, np.float64), np.zeros(len(times_s))
    begin = times[:-1][times[:-1] < t_s]
    length = times[1 : len(begin) + 1] - begin
    end = np.minimum(begin + length, t_s)
    early, late = np.exp((begin - t_s) / creep_s), np.exp((end - t_s) / creep_s)
    later = (late * (end - begin - creep_s) + early * creep_s) / length  # ∫ (s - begin) / length exp(..) ds / τ
    weights[: len(begin)] += late - early - later
    weights[1 : len(begin) + 1] += later
    return np.asarray(creep_part * np.maximum(weights, 0))


@dataclass(frozen=True, slots=True, eq=False)
class Imprint:
    """The skin's immediate deformation under a load, which the material remembers.

    `pressed_mm` (2n+1, 2n+1) is the h that objects cause, at the places where the material was without drag.
    """

    skin: Skin
    pressed_mm: F32


def imprint(skin: Skin) -> Imprint:
    """Compute the imprint of an elastic skin."""
    if skin.origin_mm is None:
        return Imprint(skin, skin.pressed_mm)
    origin = skin.origin_mm / np.float32(skin.step_mm)
    before = _nodes(len(origin))
    now = before.copy()
    for _ in range(_INVERSE_STEPS):  # this converges, because `drag` lets no skin fold
        now = before - _sampled(origin, now)
    return Imprint(skin, _sampled(skin.pressed_mm, now))


def rest(imprints: Sequence[Imprint], weights: Sequence[float], radius_mm: float, origin_mm: F32 | None) -> Skin:
    """Compute the shape without forces, which is e at every node, from weights of `kept`.

    `origin_mm` is the present `Skin.origin_mm`, by which the material moves its dent.
    """
    flat = undeformed(radius_mm)
    pressed, leaning = np.zeros_like(flat.height_mm), np.zeros_like(flat.height_mm)
    origin = np.zeros((*pressed.shape, 2), np.float32)
    for each, weight in zip(imprints, np.asarray(weights, np.float32), strict=True):
        pressed += weight * each.pressed_mm
        if each.skin.leaning_mm is not None:
            leaning += weight * each.skin.leaning_mm
        if each.skin.origin_mm is not None:
            origin += weight * each.skin.origin_mm
    if origin_mm is not None:
        pressed = _sampled(pressed, _nodes(len(pressed)) + origin_mm / np.float32(flat.step_mm))
    left = replace(flat, height_mm=pressed, origin_mm=origin if origin.any() else None)
    return left.leaning(leaning if leaning.any() else None)


def _nodes(size: int) -> F32:
    """Make the column and row of every node, (size, size, 2)."""
    axis = np.arange(size, dtype=np.float32)
    return np.stack(np.meshgrid(axis, axis), axis=-1)


def _sampled(grid: F32, at: F32) -> F32:
    """Sample a grid at columns and rows (.., 2), precise to a 32nd of a step; 0 outside."""
    return np.asarray(cv2.remap(grid, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.float32)
