from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from tacshade_edge.calibration import indenters as shapes
from tacshade_edge.calibration.indenters import (
    Indenter,
    known_height,
    place,
)
from tacshade_edge.lab.simulator.press import Press, Shape
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import disc_rays, skin_points
from tacshade_edge.types import F64, Disc, Geometry

R_MM = 20.0
DISC = Disc(61.3, 83.9, 47.7)
PLACES = ((0.0, 0.0, 2.0), (4.0, -3.0, 2.5), (-7.0, 6.0, 1.0))
TURNS = ((0.0, 0.0, 0.0), (33.0, 11.0, -8.0), (-160.0, -25.0, 14.0))


def geometry(distance_mm: float | None) -> Geometry:
    return Geometry(R_MM, distance_mm, 50.0, DISC)


def norm(*parts: F64) -> F64:
    return np.asarray(np.sqrt(sum(p * p for p in parts)))


def boxed(*sides: F64) -> F64:
    """Distance to what lies within several slabs, from the distances to each."""
    return np.asarray(
        np.minimum(np.maximum.reduce(sides), 0) + norm(*(np.maximum(s, 0) for s in sides))
    )


def cone_distance(p: F64) -> F64:
    half = math.radians(35.0)
    along = np.maximum(norm(p[:, 0], p[:, 1]) * math.sin(half) + p[:, 2] * math.cos(half), 0)
    rho, z = norm(p[:, 0], p[:, 1]), p[:, 2]
    side = rho * math.cos(half) - z * math.sin(half)
    return np.where(
        side < 0, side, np.hypot(rho - along * math.sin(half), z - along * math.cos(half))
    )


def octahedron(radius_mm: float) -> F64:
    top, bottom = np.array((0.0, 0.0, radius_mm)), np.array((0.0, 0.0, -radius_mm))
    ring = radius_mm * np.array(((1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)), float)
    return np.array([(ring[k], ring[(k + 1) % 4], end) for k in range(4) for end in (top, bottom)])


def octahedron_distance(p: F64) -> F64:
    return np.asarray(
        (np.abs(p - (0, 0, 4.0)).sum(axis=1) - 4.0) / math.sqrt(3)
    )  # right near its faces


# Sharp ones, as exact distances and the simulator's presses: nothing of `indenter` is in them.
SHAPES: dict[str, tuple[Indenter, Callable[[F64], F64]]] = {
    "cylinder": (
        shapes.cylinder("c", 5.0),
        lambda p: boxed(norm(p[:, 0], p[:, 1]) - 5.0, -p[:, 2]),
    ),
    "box": (
        shapes.box("b", 9.0, 5.0),
        lambda p: boxed(np.abs(p[:, 0]) - 4.5, np.abs(p[:, 1]) - 2.5, -p[:, 2]),
    ),
    "bar": (
        shapes.bar("r", 2.0, 12.0),
        lambda p: boxed(np.abs(p[:, 0]) - 6.0, norm(p[:, 1], p[:, 2] - 2.0) - 2.0),
    ),
    "cone": (shapes.cone("k", 70.0), cone_distance),
    "mesh": (shapes.mesh("m", octahedron(4.0) + np.array((0.0, 0.0, 17.0))), octahedron_distance),
}


@pytest.mark.slow
@pytest.mark.parametrize("distance_mm", [None, 14.0])
@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("name", SHAPES)
def test_its_surface_is_that_of_the_simulators_press(
    name: str, turn: tuple[float, float, float], distance_mm: float | None
) -> None:
    indenter, sdf = SHAPES[name]
    where = geometry(distance_mm)
    rays = disc_rays(disc_map.map_grid(DISC), where)
    for x, y, depth in PLACES:
        press = Press(Shape(name, sdf), x, y, depth, turn[0], 1.0, turn[1], turn[2])
        height = place(indenter, R_MM, x, y, depth, *turn).height_mm(rays, where)
        hit = np.isfinite(height)
        assert np.count_nonzero(hit) > 5
        points = skin_points(height, rays, where).astype(np.float64)[hit]
        # The simulator finds a tilted object's lowest point within 2 µm;
        # a circle of flats is 1.5 µm inside.
        assert np.abs(press.distance_mm(R_MM, points)).max() < 0.008
        # Nothing of it lies nearer to the camera inside the skin,
        # and what is not met is free of it.
        above = skin_points(
            np.where(rays.inside, np.float32(0.02), np.float32(np.nan)), rays, where
        )
        missed = rays.inside & ~hit
        assert press.distance_mm(R_MM, above[missed].astype(np.float64)).min() > -0.01
        nearer = skin_points(height + np.float32(0.05), rays, where).astype(np.float64)[hit]
        assert press.distance_mm(R_MM, nearer).min() > -0.008


@pytest.mark.slow
@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("name", SHAPES)
def test_the_greatest_depth_and_the_first_touch(
    name: str, turn: tuple[float, float, float]
) -> None:
    indenter, sdf = SHAPES[name]
    rng = np.random.default_rng(1)
    for x, y, depth in PLACES:
        placed = place(indenter, R_MM, x, y, depth, *turn)
        # Dense where the lowest point of an upright one is.
        spread = 6.0 * 10 ** rng.uniform(-4, 0, (40000, 1))
        sphere = spread * rng.standard_normal((40000, 3)) + (
            x,
            y,
            math.sqrt(R_MM**2 - x * x - y * y),
        )
        sphere *= R_MM / np.linalg.norm(sphere, axis=1, keepdims=True)

        def free(
            by_mm: float, points: F64 = sphere, x: float = x, y: float = y, depth: float = depth
        ) -> float:
            """How far the undeformed skin is from the indenter when that is lifted."""
            press = Press(Shape(name, sdf), x, y, depth - by_mm, turn[0], 1.0, turn[1], turn[2])
            return float(press.distance_mm(R_MM, points).min())

        travel = depth - placed.first_touch_mm(R_MM)
        assert free(travel - 0.06) < 0 < free(travel + 0.01)
        deepest = placed.depth_max_mm(R_MM)
        assert free(0.0, sphere * ((R_MM - deepest - 0.01) / R_MM)) > 0
        assert placed.deeper(0.5).first_touch_mm(R_MM) == pytest.approx(
            placed.first_touch_mm(R_MM), abs=1e-5
        )


angles = st.floats(-60, 60)


@examples(60)
@given(
    st.sampled_from(["cylinder", "box", "bar", "cone", "mesh"]),
    st.floats(1e-3, 500),
    st.floats(1e-3, 175),
    st.floats(1, 200),
    st.floats(-300, 300),
    st.floats(-300, 300),
    st.floats(1e-6, 1),
    st.floats(-360, 360),
    angles,
    angles,
    st.sampled_from([None, 0.01, 14.0, 1000.0]),
)
def test_extremes_stay_finite_and_within_the_skin(
    shape: str,
    size: float,
    angle: float,
    r: float,
    x: float,
    y: float,
    depth: float,
    yaw: float,
    tilt_x: float,
    tilt_y: float,
    distance: float | None,
) -> None:
    made = {
        "cylinder": lambda: shapes.cylinder("c", size),
        "box": lambda: shapes.box("b", size, size / 7),
        "bar": lambda: shapes.bar("r", size, size / 3),
        "cone": lambda: shapes.cone("k", angle),
        "mesh": lambda: shapes.mesh("m", size * octahedron(1.0)),
    }[shape]()
    where = Geometry(r, distance, 50.0, DISC)
    placed = place(made, r, x, y, depth * r, yaw, tilt_x, tilt_y)
    height = known_height(where, placed, 24)
    assert height.shape == (24, 24)
    found = height[np.isfinite(height)]
    assert (found > 0).all()
    assert found.max(initial=0) <= max(placed.depth_max_mm(r), 0) + 1e-4 * r
    assert placed.first_touch_mm(r) <= placed.depth_mm
