"""Sensors unlike the simulator's usual ones: irregular pins and markers, pins with any outline,
other skirts.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial import Delaunay

from tacshade_edge.lab.simulator.render import PinProfile, Print, print_at, reach_mm
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.types import F64

GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


def varied_model(model: SensorModel, rng: np.random.Generator) -> SensorModel:
    """Draw the sizes of pins and markers from wider ranges."""

    def draw(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    return replace(
        model,
        pin_length_pitches=draw(1.0, 2.2),
        pin_tip_radius_pitches=draw(0.22, 0.42),
        pin_base_radius_pitches=draw(0.16, 0.36),
        marker_radius_pitches=draw(0.33, 0.53),
        friction=draw(0.4, 1.0),
        position_tolerance_mm=draw(0, 0.08) * model.pitch_mm,
        size_tolerance=draw(0.01, 0.08),
    )


def varied_print(model: SensorModel, rng: np.random.Generator) -> Print:
    """Place pins on a spiral, on rings, on a skewed lattice or at random, bend the pattern,
    and add markers between.
    """
    p, reach = model.pitch_mm, reach_mm(model) + 2 * model.pitch_mm
    count = int((reach / p) ** 2 * math.pi * float(rng.uniform(0.95, 1.15)))
    kind = rng.integers(4)
    if kind == 0:
        n = np.arange(count)
        pins = _polar(reach * np.sqrt((n + 0.5) / count), GOLDEN_ANGLE * n.astype(float))
    elif kind == 1:
        rings = np.arange(math.ceil(reach / p) + 1) + float(rng.uniform(0, 1))
        pins = np.concatenate([_ring(p * k, p, rng) for k in rings])
    elif kind == 2:
        side = np.arange(-2 * math.ceil(reach / p) - 2, 2 * math.ceil(reach / p) + 3)
        i, j = np.meshgrid(side, side)
        angle, ratio = math.radians(float(rng.uniform(50, 80))), float(rng.uniform(1, 1.3))
        cell = (
            p
            * np.array(((1, 0), (ratio * math.cos(angle), ratio * math.sin(angle))))
            / math.sqrt(ratio)
        )
        pins = np.stack((i.ravel(), j.ravel()), axis=1) @ cell
        pins = pins[np.linalg.norm(pins, axis=1) < reach]
    else:
        pins = _apart(
            _polar(reach * np.sqrt(rng.random(count)), rng.uniform(0, 2 * math.pi, count)), reach
        )
    turn = math.radians(model.lattice_rotation_deg)
    axes = np.array(((math.cos(turn), math.sin(turn)), (-math.sin(turn), math.cos(turn))))
    size = float(rng.uniform(0, 0.25)) * p
    waves = (
        rng.normal(0, 1 / (4 * p), (4, 2)),
        rng.uniform(0, 2 * math.pi, 4),
        rng.normal(0, size / 2, (4, 2)),
    )

    def bent(points: F64) -> F64:
        points = points @ axes
        return np.asarray(
            points + np.sin(points @ waves[0].T * (2 * math.pi) + waves[1]) @ waves[2]
        )

    pins = bent(pins)
    return print_at(model, pins, _between(pins, halves=bool(rng.random() < 0.5)))


def pin_outline(rng: np.random.Generator) -> PinProfile:
    """Draw a pin with up to three rings, with or without steps, but never a bare disc on a stem."""
    heights = np.sort(rng.uniform(0.1, 0.9, int(rng.integers(0, 4))))
    rings = []
    for height in heights:
        part = float(rng.uniform(0.55, 1.3))
        if (
            rng.random() < 0.3
        ):  # a collar or a neck: a radius of the base or the tip at another height
            of_tip = float(rng.random() < 0.5)
            rings.append((float(height), part * (1 - of_tip), part * of_tip))
        else:
            rings.append((float(height), part * float(1 - height), part * float(height)))
    return PinProfile(tuple(rings))


def _between(pins: F64, halves: bool) -> F64:
    """Place markers in each triangle of neighbours,
    or where two triangles meet along their longest side.
    """
    corners = pins[Delaunay(pins).simplices]
    if not halves:
        return np.asarray(corners.mean(axis=1))
    ends = np.roll(corners, 1, axis=1)
    longest = np.linalg.norm(corners - ends, axis=2).argmax(axis=1)
    middle = ((corners + ends) / 2)[np.arange(len(corners)), longest]
    return np.unique(np.round(middle, 6), axis=0)


def _apart(points: F64, reach: float) -> F64:
    """Move each point repeatedly to the middle of its neighbours."""
    for _ in range(8):
        mesh = Delaunay(points)
        start, neighbours = mesh.vertex_neighbor_vertices
        middle = np.add.reduceat(points[neighbours], start[:-1]) / np.diff(start)[:, None]
        inside = np.linalg.norm(points, axis=1, keepdims=True) < 0.93 * reach
        points = np.where(inside, middle, points)
    return points


def _polar(rho: F64, angle: F64) -> F64:
    return np.stack((rho * np.cos(angle), rho * np.sin(angle)), axis=1)


def _ring(rho: float, pitch: float, rng: np.random.Generator) -> F64:
    count = max(1, round(2 * math.pi * rho / pitch))
    angles: F64 = np.arange(count, dtype=float) * (2 * math.pi / count) + rng.uniform(
        0, 2 * math.pi
    )
    return _polar(np.full(count, rho), angles)
