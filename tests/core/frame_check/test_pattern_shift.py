import numpy as np
import pytest
from support.calibrated_sensor import FULL, HALF, calibrated, pressed, unloaded

from tacshade_edge.core.frame_check.camera_shift import LEAST_PX
from tacshade_edge.core.frame_check.pattern_shift import PatternShift
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.image.integral_image import CellMeans
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.types import F32, U8


def cells(image: U8, model: SensorModel) -> F32:
    calibration = calibrated(model, 0)
    preprocessor = Preprocessor(calibration, PROFILES["accurate"])
    cells_of = CellMeans(preprocessor.integrator, disc_map.map_grid(calibration.geometry.disc))
    return cells_of.means(preprocessor.preprocess(preprocessor.grey(image)).white)


def check(model: SensorModel) -> PatternShift:
    calibration = calibrated(model, 0)
    cell_px = disc_map.map_grid(calibration.geometry.disc).step_px
    return PatternShift(cells(unloaded(model), model), cell_px, calibration.pitch_px)


@pytest.mark.parametrize(("model", "shift"), [(HALF, (0, 3)), (HALF, (-3, 3)), (FULL, (5, 0)), (FULL, (-4, -5))])
def test_a_pattern_that_moved_is_told_with_how_far(model: SensorModel, shift: tuple[int, int]) -> None:
    image = nuisance.shift(unloaded(model), *shift)
    assert check(model).measure_px(cells(image, model)) == pytest.approx(np.hypot(*shift), abs=0.7)


@pytest.mark.parametrize("depth_mm", [0.5, 1.0, 3.0, 5.0])
@pytest.mark.parametrize("name", ["ball", "cube", "ring", "edge", "plate"])
def test_a_contact_is_no_move(name: str, depth_mm: float) -> None:
    assert check(HALF).measure_px(cells(pressed(name, depth_mm).image, HALF)) < LEAST_PX


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_a_plain_picture_is_nowhere(level: float) -> None:
    plain = np.full((disc_map.CELLS, disc_map.CELLS), level, np.float32)
    assert check(HALF).measure_px(plain) < LEAST_PX
    assert PatternShift(plain, 3.7, 20.0).measure_px(plain) < 1e-3
