import numpy as np
import pytest

from tacshade_edge.studies.stitch.average import radius_average


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


def test_noise_is_smoothed_and_edges_are_too() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 10, (2, 8000))
    points = np.stack((x, y, (x > 5) + rng.normal(0, 0.1, x.shape)), axis=1)
    found = radius_average(points, 0.25).points()
    flat = np.abs(found[:, 0] - 5) > 1.5
    assert np.std(found[flat, 2] - (found[flat, 0] > 5)) < 0.03
    assert np.ptp(found[np.abs(found[:, 0] - 5) < 0.5, 2]) < 0.75
