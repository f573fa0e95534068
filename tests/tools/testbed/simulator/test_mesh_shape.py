from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.simulator.hand.bodies import box
from tacshade_edge.storage.meshes.stl import read_stl, stl_bytes
from tacshade_edge.types import F64
from tools.testbed.simulator.mesh_shape import mesh_shape


def cuboid(x_mm: float, y_mm: float, z_mm: float) -> F64:
    """Twelve triangles (12, 3, 3) of a box about the origin, counter-clockwise from outside."""
    triangles = []
    for axis, sign in itertools.product(range(3), (-1, 1)):
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        a, b, c, d = (sign * np.eye(3)[axis] + s * u + t * v for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
        triangles += [(a, b, c), (a, c, d)] if sign > 0 else [(a, c, b), (a, d, c)]
    return np.array(triangles) * np.array((x_mm, y_mm, z_mm)) / 2


def test_a_box_from_an_stl_file_has_a_boxs_distances(tmp_path: Path) -> None:
    path = tmp_path / "box.stl"
    path.write_bytes(stl_bytes(cuboid(20.0, 14.0, 9.0)))
    shape = mesh_shape(read_stl(path))
    points = np.random.default_rng(0).uniform(-1, 1, (2000, 3)) * (13.0, 10.0, 8.0)
    off = np.abs(shape.sdf(points) - box(20.0, 14.0, 9.0, rounding_mm=1e-6).sdf(points))
    assert off.max() < 0.5, "an edge is rounded by the grid"
    assert np.median(off) < 0.01
    assert shape.sdf(points.astype(np.float32)).dtype == np.float32


def test_far_away_a_distance_is_too_small_never_too_large() -> None:
    shape, true = mesh_shape(cuboid(20.0, 14.0, 9.0)), box(20.0, 14.0, 9.0, rounding_mm=1e-6)
    points = np.random.default_rng(1).uniform(-60, 60, (2000, 3))
    far = np.abs(points).max(axis=1) > 20
    assert np.all(shape.sdf(points)[far] <= true.sdf(points)[far] + 1e-4)
    assert shape.sdf(points)[far].min() > 4.0


@pytest.mark.parametrize("step_mm", [0.5, 2.0])
def test_a_finer_grid_is_nearer(step_mm: float) -> None:
    points = np.array(((10.0, 7.0, 4.5), (10.0, 0.0, 0.0)))
    corner, face = mesh_shape(cuboid(20.0, 14.0, 9.0), step_mm).sdf(points)
    assert abs(face) < 1e-3
    assert abs(corner) < 0.6 * step_mm
