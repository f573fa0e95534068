"""The paper's average of the points of all presses."""

from __future__ import annotations

import numpy as np
import pytest

from tacshade_edge.stitching import average
from tacshade_edge.stitching.average import radius_average
from tacshade_edge.types import F64


def test_each_height_is_the_mean_of_those_in_the_radius() -> None:
    # Three in a row, 0.8 mm apart: the middle one sees both others, the outer ones only it.
    points = np.array(((0.0, 0.0, 1.0), (0.8, 0.0, 2.0), (1.6, 0.0, 6.0), (520.0, 0.0, 9.0)))
    raster = radius_average(points, step_mm=0.4, radius_mm=1.0)
    found = {round(x, 1): z for x, _, z in raster.points()}
    assert found == {
        0.0: pytest.approx(1.5),
        0.8: pytest.approx(3.0),
        1.6: pytest.approx(4.0),
        520.0: pytest.approx(9.0),
    }


def brute_means(points_mm: F64, radius_mm: float) -> F64:
    apart = np.linalg.norm(points_mm[:, None, :2] - points_mm[None, :, :2], axis=-1)
    near = apart <= radius_mm
    return np.asarray((near * points_mm[:, 2]).sum(axis=1) / near.sum(axis=1))


def test_parts_of_the_points_give_the_means_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    points = np.random.default_rng(3).uniform(0, 8, (101, 3))
    points[7] = points[8]  # two presses may find the same point
    monkeypatch.setattr(average, "_CHUNK", 10)
    np.testing.assert_allclose(
        average.mean_heights(points, 1.0), brute_means(points, 1.0), atol=1e-12
    )
