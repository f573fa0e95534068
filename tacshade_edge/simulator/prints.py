"""What is printed on a skin: pins and markers on any lattice, pins with any outline."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tacshade_edge.simulator.model import MAX_VISIBLE_HALF_ANGLE_DEG, SensorModel
from tacshade_edge.simulator.skin import direction_to_chart
from tacshade_edge.types import F64

_MARKER_CORNERS = 12


@dataclass(frozen=True, slots=True)
class PinProfile:
    """The pin's outline between base and tip, as cones between rings. `rings`: each ring's height (0 at the base, 1 at
    the tip) and its radius, the sum of a part of the base's radius and a part of the tip's.
    """

    rings: tuple[tuple[float, float, float], ...]

    @classmethod
    def waist(cls, height: float, part: float) -> PinProfile:
        """Make a frustum whose radius at a height is multiplied by `part`, which gives a waist or a belly."""
        return cls(((height, part * (1 - height), part * height),))


FRUSTUM, CAP = PinProfile(()), PinProfile(((1.0, 0.7, 0.0),))
"""Cones between base and tip, and tapering stems under flat caps."""


@dataclass(frozen=True, slots=True, eq=False)
class Print:
    """The printed features of one sensor, on the undeformed skin. `marker_chart_mm` (float (M, corners, 2)): outlines
    of the markers in the skin's chart; they are on the skin and deform with it. `pin_chart_mm` (float (P, 2)):
    positions of the pins in the skin's chart. `pin_base_mm`, `pin_tip_mm`, `pin_length_mm`: float (P,).
    """

    marker_chart_mm: F64
    pin_chart_mm: F64
    pin_base_mm: F64
    pin_tip_mm: F64
    pin_length_mm: F64


def print_features(model: SensorModel) -> Print:
    """Lay the hexagonal lattice on the sphere (equal-area chart) with the model's print tolerances."""
    rng = np.random.default_rng((model.print_seed, 1))
    r, p = model.skin_radius_mm, model.pitch_mm
    reach = math.radians(min(model.visible_half_angle_deg + 6.0, MAX_VISIBLE_HALF_ANGLE_DEG + 4.0))
    limit = 2 * r * math.sin(reach / 2)
    n = math.ceil(limit / (p * 0.86)) + 1
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    corner = np.stack(((i + 0.5 * j).ravel(), (j * math.sqrt(0.75)).ravel()), axis=1) * p
    third = np.array((0.5, math.sqrt(1 / 12))) * p  # centre of the triangle right above a lattice point
    a = math.radians(model.lattice_rotation_deg)
    turn = np.array(((math.cos(a), math.sin(a)), (-math.sin(a), math.cos(a))))

    def lay(points: F64) -> F64:
        points = points @ turn
        points = points + rng.normal(0.0, model.position_tolerance_mm, points.shape)
        return np.asarray(points[np.linalg.norm(points, axis=1) < limit])

    def sizes(pitches: float, count: int) -> F64:
        return pitches * p * np.clip(1 + model.size_tolerance * rng.standard_normal(count), 0.5, 1.5)

    pins = lay(corner)
    # The second triangle of each lattice cell is the first one mirrored in the cell's middle.
    markers = lay(np.concatenate((corner + third, corner - third)))
    # Regular polygons of the same area as the discs.
    area = math.sqrt(2 * math.pi / (_MARKER_CORNERS * math.sin(2 * math.pi / _MARKER_CORNERS)))
    return _printed(model, pins, markers, sizes, area)


def lattice_print(model: SensorModel, angle_deg: float, ratio: float = 1.0) -> Print:
    """Place pins on a lattice with any angle and ratio of sides, and a marker in the middle of each cell."""
    n = 2 * math.ceil(reach_mm(model) / model.pitch_mm) + 2
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    a, b = math.radians(model.lattice_rotation_deg), math.radians(angle_deg)
    sides = np.array(((1.0, 0.0), (ratio * math.cos(b), ratio * math.sin(b)))) / math.sqrt(ratio)
    cell = model.pitch_mm * sides @ np.array(((math.cos(a), math.sin(a)), (-math.sin(a), math.cos(a))))
    corners = np.stack((i.ravel(), j.ravel()), axis=1)
    return print_at(model, corners @ cell, (corners + 0.5) @ cell)


def reach_mm(model: SensorModel) -> float:
    """Compute how far from the apex the print reaches, in the equal-area chart."""
    return 2 * model.skin_radius_mm * math.sin(math.radians(model.visible_half_angle_deg + 6) / 2)


def print_at(model: SensorModel, pins_mm: F64, markers_mm: F64) -> Print:
    """Print pins and markers at points (N, 2) of the equal-area chart, with the model's tolerances."""
    rng = np.random.default_rng((model.print_seed, 14))
    p, limit = model.pitch_mm, reach_mm(model)

    def lay(points: F64) -> F64:
        points = points + rng.normal(0, model.position_tolerance_mm, points.shape)
        return np.asarray(points[np.linalg.norm(points, axis=1) < limit])

    def sizes(pitches: float, count: int) -> F64:
        return np.asarray(pitches * p * np.clip(1 + model.size_tolerance * rng.standard_normal(count), 0.5, 1.5))

    pins, markers = lay(pins_mm), lay(markers_mm)
    return _printed(model, pins, markers, sizes, 1.0)


def _printed(
    model: SensorModel, pins: F64, markers: F64, sizes: Callable[[float, int], F64], marker_part: float
) -> Print:
    """The print with pins and markers at points of the equal-area chart."""
    r = model.skin_radius_mm
    radius = sizes(model.marker_radius_pitches, len(markers)) * marker_part
    angles = np.arange(_MARKER_CORNERS) * (2 * math.pi / _MARKER_CORNERS)
    circle = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    centre = equal_area_to_direction(markers, r)
    east, north = tangents(centre)
    ring = centre[:, None, :] * r + radius[:, None, None] * (
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
    """Convert Lambert's equal-area chart to unit vectors; the lattice keeps its density all over the sphere."""
    x, y = points[..., 0] / radius, points[..., 1] / radius
    s = x * x + y * y
    k = np.sqrt(np.maximum(1 - s / 4, 0))
    return np.stack((x * k, y * k, 1 - s / 2), axis=-1)


def tangents(normal: F64) -> tuple[F64, F64]:
    """Two unit vectors (P, 3) perpendicular to each unit normal."""
    helper = np.where(np.abs(normal[:, :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    first = np.cross(normal, helper)
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normal, first)
