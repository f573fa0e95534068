from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np
import pytest

from support.calibrated_sensor import (
    HALF,
    PIN_LENGTH_MM,
    TACTIP,
    found_prints,
    sensor_of,
    simulated,
)
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.lab.simulator import skin, truth
from tacshade_edge.lab.simulator.drag import drag_skin
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.simulator.render import carried
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import Skin, press_skin
from tacshade_edge.types import F64, Calibration

if TYPE_CHECKING:
    from tacshade_edge.lab.fitting.prints import Found

pytestmark = [
    pytest.mark.fit,
    pytest.mark.skipif(find_spec("numba") is None, reason="numba (the extra fit) is not installed"),
]


def of(model: SensorModel) -> Calibration:
    return calibrate(
        sensor_of(model), [simulated(model).frame((), k).image for k in range(3)]
    ).calibration


def assert_found(best: Found, model: SensorModel) -> None:
    from tacshade_edge.lab.fitting.identify import MERGED

    assert best.kind.white_tips == (model.pin_tip_reflectance > 0.5)
    assert best.residual < 0.6
    found_mm = best.base.pitch_mm * best.values[:3]
    true_mm = model.pitch_mm * np.array(
        (model.pin_length_pitches, model.pin_tip_radius_pitches, model.pin_base_radius_pitches)
    )
    assert found_mm[1] == pytest.approx(true_mm[1], rel=0.12)
    if not best.kind.white_tips:
        assert len(best.kind.marker_parts) == 2
        assert best.values[3] == MERGED  # nothing shows the size of markers that merge
        assert found_mm[0] == pytest.approx(true_mm[0], rel=0.2)
        assert found_mm[2] == pytest.approx(true_mm[2], rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize(
    "model", [TACTIP, replace(HALF, pin_length_pitches=1.3, print_seed=3)], ids=["tips", "short"]
)
def test_the_print_is_found_as_it_was_made(model: SensorModel) -> None:
    from tacshade_edge.lab.fitting.identify import identify

    assert_found(identify(of(model))[0], model)


def test_sizes_stay_within_what_a_sensor_can_have() -> None:
    from tacshade_edge.lab.fitting.identify import BOXES, LEAST, MOST, quadratic

    tried = []
    best = np.array((2.3, 0.44, 0.1, 0.4, 0.3))

    def residual(values: F64) -> F64:
        tried.append(values)
        return values - best

    start = np.array((2.35, 0.45, 0.09, 0.4, 0.25))
    values, _ = quadratic(residual, start, (0, 1, 2, 4), BOXES[0], 0)
    np.testing.assert_allclose(values[[0, 4]], best[[0, 4]], atol=0.01)  # near the bounds, too
    for each in (
        *tried,
        values,
        quadratic(lambda each: each - 10.0, start, (0, 1, 2, 4), BOXES[0], 0)[0],
    ):
        assert (each[[0, 1, 2, 4]] >= LEAST).all()
        assert (each[[0, 1, 2, 4]] <= MOST).all()
        assert each[3] == 0.4


@pytest.mark.slow
def test_what_the_drawing_states_is_not_fitted() -> None:
    best = found_prints()[0]
    assert best.base.pitch_mm * best.values[0] == pytest.approx(PIN_LENGTH_MM)
    assert_found(best, HALF)


MODEL = SensorModel()


@pytest.fixture(scope="module")
def dragged() -> Skin:
    presses = (Press(OBJECTS["cube"](), 2.0, -1.0, 3.0, drag_x_mm=2.0, twist_deg=5.0),)
    return drag_skin(
        lambda lean: press_skin(20.0, MODEL.skin_decay_mm, presses, lean), MODEL, presses
    )


@pytest.mark.slow
def test_compiled_parts_agree_with_the_simulator(dragged: Skin) -> None:
    from tacshade_edge.lab.fitting import compiled

    rng = np.random.default_rng(0)
    chart = rng.uniform(-14, 14, (300, 2))
    for friction in (0.7, 1.0):
        direction, now = carried(dragged, chart, friction)
        found_direction, found = compiled.carried(dragged, chart, friction)
        np.testing.assert_allclose(found, now, atol=6e-3)
        np.testing.assert_allclose(found_direction, direction, atol=6e-4)
    rows, cols = rng.uniform(60, 420, 300), rng.uniform(150, 500, 300)
    points = truth.skin_points(dragged, MODEL.geometry, rows, cols)
    np.testing.assert_allclose(
        compiled.skin_points(dragged, MODEL.geometry, rows, cols), points, atol=2e-3
    )
    shear = truth.shear_mm(dragged, points, 0.9)
    np.testing.assert_allclose(compiled.shear_mm(dragged, points, 0.9), shear, atol=6e-3)
    obstacle = rng.uniform(-1, 1, (60, 60)).clip(0).astype(np.float32)
    mass = np.full((60, 60), 0.02, np.float32)
    np.testing.assert_allclose(
        compiled.solve(obstacle, mass), skin.solve(obstacle, mass), atol=5e-3
    )
    held = rng.normal(1, 0.2, (2, 60, 60)).astype(np.float32)
    slips = compiled.slid(held, 0.2 * obstacle, mass)
    np.testing.assert_allclose(slips, skin.slid(held, 0.2 * obstacle, mass), atol=5e-3)
    assert np.abs(slips - held)[:, obstacle > 0].mean() > 0.01
