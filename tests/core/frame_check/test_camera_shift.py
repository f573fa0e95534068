from dataclasses import replace

import numpy as np
import pytest
from support.calibrated_sensor import FULL, HALF, calibrated, pressed, simulated, unloaded

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.devices.weights.network import make_reconstructor
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.types import Frame

DARK = replace(FULL, surround="dark")


@pytest.mark.parametrize(("model", "shift"), [(HALF, (0, 3)), (HALF, (-3, 3)), (FULL, (5, 0)), (FULL, (-4, -5))])
def test_a_camera_that_moved_is_told(model: SensorModel, shift: tuple[int, int]) -> None:
    image = nuisance.shift(unloaded(model), *shift)
    result = make_reconstructor(calibrated(model, 0), PROFILES["accurate"]).step(Frame(0, 0, 0, image))
    assert not result.contact  # what the gate lets pass is refused


@pytest.mark.parametrize(
    ("profile", "model"), [*((name, FULL) for name in PROFILES), ("fast", DARK), ("accurate", DARK)]
)
def test_what_it_refuses_says_why_in_the_cameras_pixels(profile: str, model: SensorModel) -> None:
    made = make_reconstructor(calibrated(model, 0), PROFILES[profile])
    result = made.step(Frame(0, 0, 0, nuisance.shift(unloaded(model), 4, 5)))
    assert not result.valid
    assert result.reason is not None
    assert result.reason.code is ReasonCode.CAMERA_SHIFT
    assert float(result.reason.text.split()[3]) == pytest.approx(
        np.hypot(4, 5), abs=1.0 if PROFILES[profile].halved else 0.7
    )
    assert not result.contact


@pytest.mark.parametrize("profile", ["fast", "accurate"])
@pytest.mark.parametrize("shift", [(0, 0), (1, 0), (-1, 1)])
def test_a_pixel_is_let_pass(profile: str, shift: tuple[int, int]) -> None:
    made = make_reconstructor(calibrated(FULL, 0), PROFILES[profile])
    for image in (unloaded(FULL), pressed("ball", 1.0, FULL).image):
        result = made.step(Frame(0, 0, 0, nuisance.shift(image, *shift)))
        assert result.reason is None


@pytest.mark.parametrize("profile", ["fast", "accurate"])
def test_skin_that_leans_with_a_drag_is_not_refused(profile: str) -> None:
    leaning = replace(FULL, sway=0.6, coulomb=50.0)
    made = make_reconstructor(calibrated(FULL, 0), PROFILES[profile])
    for k in range(4):
        drag_x_mm, drag_y_mm = ((5.0, 0.0), (0.0, 5.0), (-5.0, 0.0), (3.0, -3.0))[k]
        press = Press(ball(), 1.0, 1.0, 3.0, drag_x_mm=drag_x_mm, drag_y_mm=drag_y_mm)
        result = made.step(Frame(0, 0, 0, simulated(leaning).frame((press,), k).image))
        assert result.reason is None
        assert result.contact
