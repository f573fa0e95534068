import itertools

import numpy as np
import pytest

from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.studies.evaluate.scenes import DEPTHS_MM, RINGS, null_images, places, scenes
from tacshade_edge.studies.evaluate.sensors import SensorName


def test_every_place_and_depth_once_and_the_same_again() -> None:
    model = random_model(5)
    made = scenes(model, 5, "cube")
    grid = [((s.press.x_mm, s.press.y_mm, s.press.rotation_deg), s.press.depth_mm) for s in made]
    assert grid == list(itertools.product(places(model, 5), DEPTHS_MM))
    assert len(grid) == len(set(grid)) == 9
    assert len({s.noise_seed for s in made}) == 9
    assert {s.press.scale for s in made} == {model.skin_radius_mm / 20}


@pytest.mark.parametrize("seed", [None, 0, 5, 11, 9001])
def test_places_lie_in_their_rings_and_differ_by_seed(seed: int | None) -> None:
    model = SensorModel()
    found = places(model, seed)
    assert found == places(model, seed)
    for (low, high), (x, y, turn) in zip(RINGS, found, strict=True):
        assert low - 1e-3 <= np.hypot(x, y) / model.skin_radius_mm <= high + 1e-3
        assert 0 <= turn <= 360
    assert all(places(model, other) != found for other in (1, 2, 8999))


def test_frames_without_contact_are_as_a_sensor_in_use_makes_them() -> None:
    sensor = SensorName.parse("default").make()
    made = null_images(sensor, 6)
    assert [what for what, _ in made] == ["", "light x0.8", "light x1.2", "a row down", "a column right", ""]
    first, dim, bright, *_, sixth = (image.astype(int) for _, image in made)
    assert dim.mean() < 0.9 * first.mean() < 0.95 * bright.mean()
    assert 0 < np.abs(first - sixth).mean() < 10  # the same scene with other noise
