import numpy as np
import pytest
from support.calibrated_sensor import FULL, HALF, calibrated, pressed, unloaded

from tacshade_edge.core.frame_check.camera_shift import CameraShift
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.image.integral_image import CellMeans
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.simulator import camera_faults
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.types import F32, U8, Frame


def cells(image: U8, model: SensorModel) -> F32:
    calibration = calibrated(model, 0)
    preprocessor = Preprocessor(calibration, PROFILES["accurate"])
    cells_of = CellMeans(preprocessor.integrator, disc_map.map_grid(calibration.geometry.disc))
    return cells_of.means(preprocessor.preprocess(preprocessor.grey(image)).white)


def check(model: SensorModel) -> CameraShift:
    calibration = calibrated(model, 0)
    cell_px = disc_map.map_grid(calibration.geometry.disc).step_px
    return CameraShift(cells(unloaded(model), model), cell_px, calibration.pitch_px)


@pytest.mark.parametrize(("model", "shift"), [(HALF, (0, 3)), (HALF, (-3, 3)), (FULL, (5, 0)), (FULL, (-4, -5))])
def test_a_camera_that_moved_is_told_with_how_far(model: SensorModel, shift: tuple[int, int]) -> None:
    image = camera_faults.shift(unloaded(model), *shift)
    reason = check(model).reason(cells(image, model))
    assert reason is not None
    assert reason.code is ReasonCode.CAMERA_SHIFT
    assert float(reason.text.split()[5]) == pytest.approx(np.hypot(*shift), abs=0.7)
    result = make_reconstructor(calibrated(model, 0), PROFILES["accurate"]).step(Frame(0, 0, 0, image))
    assert not result.contact  # what the gate lets pass is refused


@pytest.mark.parametrize("profile", PROFILES)
def test_what_it_refuses_says_why_in_the_cameras_pixels(profile: str) -> None:
    made = make_reconstructor(calibrated(FULL, 0), PROFILES[profile])
    result = made.step(Frame(0, 0, 0, camera_faults.shift(unloaded(FULL), 4, 5)))
    assert not result.valid
    assert result.reason is not None
    assert result.reason.code is ReasonCode.CAMERA_SHIFT
    assert float(result.reason.text.split()[5]) == pytest.approx(
        np.hypot(4, 5), abs=1.0 if PROFILES[profile].halved else 0.7
    )
    assert not result.contact


@pytest.mark.parametrize("depth_mm", [0.5, 1.0, 3.0, 5.0])
@pytest.mark.parametrize("name", ["ball", "cube", "ring", "edge", "plate"])
def test_a_contact_is_no_move(name: str, depth_mm: float) -> None:
    assert check(HALF).reason(cells(pressed(name, depth_mm).image, HALF)) is None


@pytest.mark.parametrize("shift", [(0, 0), (1, 0), (-1, 1)])
def test_a_pixel_is_let_pass(shift: tuple[int, int]) -> None:
    for image in (unloaded(), pressed("ball", 1.0).image):
        assert check(HALF).reason(cells(camera_faults.shift(image, *shift), HALF)) is None


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_a_plain_picture_is_nowhere(level: float) -> None:
    plain = np.full((disc_map.CELLS, disc_map.CELLS), level, np.float32)
    assert check(HALF).reason(plain) is None
    assert CameraShift(plain, 3.7, 20.0).reason(plain) is None
