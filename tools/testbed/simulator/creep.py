"""Creep and recovery of the skin: the standard linear solid.

A spring in series with a spring and a dashpot side by side (Zener, Elasticity and Anelasticity of Metals, 1948;
Findley, Lai and Onaran, Creep and Relaxation of Nonlinear Viscoelastic Materials, 1976, ch. 5). With u what a load
makes at once, the second spring follows τ e' = c u - e, so that

    e(t) = c/τ ∫ u(s) exp(-(t - s)/τ) ds:

a load that is held lets u grow to u (1 + c (1 - exp(-t/τ))), and when it is gone e is left and decays by exp(-t/τ),
from at most c / (1 + c) of the depth. Membrane and foundation of the skin are taken to be of one such solid. Then e
is a shape that nothing holds, and the contact with it is the elastic one on a skin of that shape: the correspondence
of Lee and Radok (J. Appl. Mech. 27, 1960), here for any history. Along the skin u is what an object drags, whose place
is given and not its load; that differs by c² of it.
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
    """Weigh the knots of a history: e(t) is the sum of u at them, each by its weight.

    Parameters
    ----------
    times_s : sequence of float (K,)
        Increasing. Between two of them u goes straight from one value to the next, and it is 0 before and after.
    t_s : float
    creep_part, creep_s : float
        c and τ.

    Returns
    -------
    float64 (K,)
        At least 0; their sum is at most `creep_part`.
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
    """What a load makes of the skin at once, for the material to remember.

    Attributes
    ----------
    skin : Skin
    pressed_mm : float32 (2n+1, 2n+1)
        Its h by objects, not where the material is now but where it was without drag.
    """

    skin: Skin
    pressed_mm: F32


def imprint(skin: Skin) -> Imprint:
    """The imprint of an elastic skin."""
    if skin.origin_mm is None:
        return Imprint(skin, skin.pressed_mm)
    origin = skin.origin_mm / np.float32(skin.step_mm)
    before = _nodes(len(origin))
    now = before.copy()
    for _ in range(_INVERSE_STEPS):  # a contraction: `drag` lets no skin fold
        now = before - _sampled(origin, now)
    return Imprint(skin, _sampled(skin.pressed_mm, now))


def rest(imprints: Sequence[Imprint], weights: Sequence[float], radius_mm: float, origin_mm: F32 | None) -> Skin:
    """The shape that nothing holds: e of every node.

    Parameters
    ----------
    imprints : sequence of Imprint
    weights : sequence of float
        `kept`.
    radius_mm : float
    origin_mm : float32 (2n+1, 2n+1, 2) or None
        `Skin.origin_mm` now: the material takes its dent along.
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
    """Column and row of every node, (size, size, 2)."""
    axis = np.arange(size, dtype=np.float32)
    return np.stack(np.meshgrid(axis, axis), axis=-1)


def _sampled(grid: F32, at: F32) -> F32:
    """A grid at columns and rows (.., 2), to a 32nd of a step; 0 outside."""
    return np.asarray(cv2.remap(grid, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.float32)
