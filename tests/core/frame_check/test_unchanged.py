from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.calibrated_sensor import FULL, HALF, TACTIP, calibrated, simulated, unloaded

from tacshade_edge.core.frame_check.unchanged import LEVELS, UnchangedSkin
from tacshade_edge.core.frame_check.validity import sensor_check
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.simulator import camera_faults
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.press import Press, ball
from tacshade_edge.types import U8, Frame, Need, Reconstruction


def fresh(profile: str, model: SensorModel = HALF) -> Reconstructor:
    """One that has seen no frame."""
    return make_reconstructor(calibrated(model), PROFILES[profile])


def recognised(made: Reconstructor, image: U8) -> bool:
    return made._unchanged.shown_in(made._preprocessor.grey(image))


def said(result: Reconstruction | None) -> object:
    return None if result is None else (result.valid, result.reason, result.degraded, result.contact)


def each_by_itself(images: list[U8], profile: str, model: SensorModel, **step: Any) -> list[object]:
    """By a reconstructor that remembers no frame before it."""
    made = fresh(profile, model)
    found = []
    for k, image in enumerate(images):
        made._unchanged._kept = None
        found.append(said(made.step(Frame(k, k, k, image), **step)))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("profile", ["balanced", "accurate"])
@pytest.mark.parametrize("model", [HALF, FULL, TACTIP], ids=["half", "full", "tactip"])
def test_frames_of_a_free_skin_are_judged_once(profile: str, model: SensorModel) -> None:
    made = fresh(profile, model)
    for k in range(6):
        image = unloaded(model, noise_seed=300 + k)
        assert recognised(made, image) is (k > 0)
        result = made.step(Frame(k, 7 * k, 9 * k, image))
        assert result.valid
        assert not result.contact
        assert (result.seq, result.t_ns, result.wall_ns) == (k, 7 * k, 9 * k)
        assert np.nansum(np.abs(result.height.height_mm)) == 0


@pytest.mark.slow
@pytest.mark.parametrize("profile", ["balanced", "accurate"])
def test_a_press_that_creeps_in_is_felt_as_early(profile: str) -> None:
    depths_mm = np.arange(0.0, 0.5, 0.004)
    images = [simulated(HALF).frame((Press(ball(8.0), 0.0, 0.0, d),) if d else (), 100).image for d in depths_mm]
    made, known, found = fresh(profile), 0, list[object]()
    for k, image in enumerate(images):
        known += recognised(made, image)
        found.append(said(made.step(Frame(k, k, k, image), need=Need.CONTACT)))
    assert found == each_by_itself(images, profile, HALF, need=Need.CONTACT)
    assert found[-1] is None, "the deepest is felt"
    assert known >= 3


@pytest.mark.slow
def test_light_that_fades_is_reported_as_early() -> None:
    images = [camera_faults.gain(unloaded(), 1 - 0.02 * k) for k in range(40)]
    made = fresh("balanced")
    found = [said(made.step(Frame(k, k, k, image))) for k, image in enumerate(images)]
    assert found == each_by_itself(images, "balanced", HALF)
    assert found[0] != found[-1]


def test_what_was_degraded_stays_degraded() -> None:
    image = unloaded().copy()
    rows, cols = (size // 2 for size in image.shape[:2])
    image[rows : rows + 25, cols : cols + 25] = 255  # glare
    made = fresh("balanced")
    first, second = (made.step(Frame(k, k, k, image)) for k in range(2))
    assert first.valid
    assert first.degraded
    assert second.degraded == first.degraded
    assert made.step(Frame(2, 2, 2, unloaded())).degraded is None


def test_a_frame_of_another_size_or_black_is_not_taken_for_it() -> None:
    made = fresh("balanced")
    image = unloaded()
    assert made.step(Frame(0, 0, 0, image)).valid
    assert not made.step(Frame(1, 1, 1, image[:-2])).valid
    assert not made.step(Frame(2, 2, 2, np.zeros_like(image))).valid
    assert made.step(Frame(3, 3, 3, image)).valid


@pytest.mark.parametrize(("levels", "shown"), [(LEVELS, True), (LEVELS + 1, False)])
@pytest.mark.parametrize("halved", [True, False])
def test_one_pixel_decides(levels: float, shown: bool, halved: bool) -> None:
    calibration = calibrated()
    grey = calibration.reference_grey.copy()
    memory = UnchangedSkin(sensor_check(calibration), halved)
    assert not memory.shown_in(grey), "no frame was judged"
    disc = calibration.geometry.disc
    row, col = round(disc.row_c) // 2 * 2, round(disc.col_c) // 2 * 2
    grey[row : row + 2, col : col + 2] = 100
    memory.keep(grey, None)
    grey[row : row + (1 if halved else 2), col : col + (1 if halved else 2)] = 100 + levels
    assert memory.shown_in(grey) is shown
