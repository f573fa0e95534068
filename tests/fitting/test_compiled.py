from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from tacshade_edge.simulator import relaxation, truth
from tacshade_edge.simulator.drag import drag_skin
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.press import OBJECTS, Press
from tacshade_edge.simulator.render import carried
from tacshade_edge.simulator.skin import Skin, press_skin

pytestmark = [
    pytest.mark.fit,
    pytest.mark.skipif(find_spec("numba") is None, reason="numba (the extra fit) is not installed"),
]
MODEL = SensorModel()


@pytest.fixture(scope="module")
def dragged() -> Skin:
    presses = (Press(OBJECTS["cube"](), 2.0, -1.0, 3.0, drag_x_mm=2.0, twist_deg=5.0),)
    return drag_skin(lambda lean: press_skin(20.0, MODEL.skin_decay_mm, presses, lean), MODEL, presses)


@pytest.mark.slow
def test_compiled_parts_agree_with_the_simulator(dragged: Skin) -> None:
    from tacshade_edge.fitting import compiled

    rng = np.random.default_rng(0)
    chart = rng.uniform(-14, 14, (300, 2))
    for friction in (0.7, 1.0):
        direction, now = carried(dragged, chart, friction)
        found_direction, found = compiled.carried(dragged, chart, friction)
        np.testing.assert_allclose(found, now, atol=6e-3)
        np.testing.assert_allclose(found_direction, direction, atol=6e-4)
    rows, cols = rng.uniform(60, 420, 300), rng.uniform(150, 500, 300)
    points = truth.skin_points(dragged, MODEL.geometry, rows, cols)
    np.testing.assert_allclose(compiled.skin_points(dragged, MODEL.geometry, rows, cols), points, atol=2e-3)
    shear = truth.shear_mm(dragged, points, 0.9)
    np.testing.assert_allclose(compiled.shear_mm(dragged, points, 0.9), shear, atol=6e-3)
    obstacle = rng.uniform(-1, 1, (60, 60)).clip(0).astype(np.float32)
    mass = np.full((60, 60), 0.02, np.float32)
    np.testing.assert_allclose(compiled.solve(obstacle, mass), relaxation.solve(obstacle, mass), atol=5e-3)
