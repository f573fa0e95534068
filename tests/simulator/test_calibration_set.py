import math

import numpy as np

from tacshade_edge.simulator.calibration_set import ball_presses
from tacshade_edge.simulator.model import SensorModel, random_model


def test_presses_cover_radii_depths_and_the_disc() -> None:
    drawn = ball_presses(SensorModel(), 40)
    radii, depths = [r for _, r in drawn], [p.depth_mm for p, _ in drawn]
    assert 3.0 <= min(radii) < 3.3 < 8.7 < max(radii) <= 9.0
    assert 0.5 <= min(depths) < 0.7 < 3.8 < max(depths) <= 4.0
    places = np.array([(p.x_mm, p.y_mm) for p, _ in drawn])
    away = np.linalg.norm(places, axis=1)
    assert away.max() < 20.0 * math.sin(math.radians(50.0))
    for sign_x in (-1, 1):
        for sign_y in (-1, 1):
            assert np.sum((places[:, 0] * sign_x > 0) & (places[:, 1] * sign_y > 0)) >= 8


def test_presses_are_repeatable_and_fit_every_skin() -> None:
    for seed in range(5):
        model = random_model(seed)
        one, same = ball_presses(model, 10, seed), ball_presses(model, 10, seed)
        assert [(r, p.depth_mm, p.x_mm) for p, r in one] == [(r, p.depth_mm, p.x_mm) for p, r in same]
        assert all(p.lowest_z_mm(model.skin_radius_mm) > 0 for p, _ in one)
    assert ball_presses(SensorModel(), 0) == []
