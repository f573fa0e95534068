from __future__ import annotations

import re

import numpy as np
import pytest
from calibrated_sensor import FULL, HALF, TACTIP, calibrated, pressed, random_sensor, simulated, unloaded

from tacshade_edge.core.disc import disc_mask
from tacshade_edge.core.greyscale import to_grey
from tacshade_edge.core.preprocess import Preprocessor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.validity import FrameCheck, frame_check, invalid_reason
from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.types import U8, Disc


def check_of(model: SensorModel) -> FrameCheck:
    calibration = calibrated(model, 0)
    mask = disc_mask(calibration.image_height_px, calibration.image_width_px, calibration.geometry.disc)
    return frame_check(calibration.reference_grey, mask, calibration.geometry.disc)


def bad_frames(good: U8) -> dict[str, tuple[U8, str]]:
    """Frames that cannot be used, and what must be said of them."""
    rows = good.shape[0]
    black, grey, white = good * 0, good * 0 + 128, good * 0 + 255
    return {
        "black": (black, "black"),
        "nearly black": (black + 5, "black"),
        "grey": (grey, "no contrast"),
        "white": (white, "saturated"),
        "half white": (nuisance.torn(good, white, rows // 2), "saturated"),
        "torn, black below": (nuisance.torn(good, black, rows // 2), "torn"),
        "torn, grey below": (nuisance.torn(good, grey, rows // 2), "torn"),
        "torn, black from three quarters": (nuisance.torn(good, black, 3 * rows // 4), "torn"),
        "line sync lost": (nuisance.torn(good, good, rows // 2, 40), "torn"),
        "noise": (nuisance.noise(good, 30, 1), "noise"),
        "a third of the light": (nuisance.gain(good, 0.3), "light"),
        "three times the light": (nuisance.gain(good, 3), "light|saturated"),
        "half the size": (good[::2, ::2], "size"),
        "transposed": (np.ascontiguousarray(np.swapaxes(good, 0, 1)), "size"),
    }


@pytest.mark.parametrize("model", [HALF, FULL], ids=["half", "full"])
@pytest.mark.parametrize("touched", [False, True])
@pytest.mark.parametrize("name", bad_frames(np.zeros((8, 8), np.uint8)))
def test_a_bad_frame_is_told_why(model: SensorModel, touched: bool, name: str) -> None:
    good = pressed("ball", 3.0, model).image if touched else unloaded(model)
    image, said = bad_frames(good)[name]
    reason = invalid_reason(to_grey(image), check_of(model))
    assert any(reason.startswith(word) for word in said.split("|")), reason
    assert "\n" not in reason
    assert "nan" not in reason


@pytest.mark.parametrize(
    "model", [HALF, TACTIP, random_sensor(0), random_sensor(1)], ids=["half", "tactip", "r0", "r1"]
)
def test_an_unloaded_frame_is_good_also_with_a_nuisance(model: SensorModel) -> None:
    good, check = unloaded(model), check_of(model)
    for image in (
        good,
        nuisance.gain(good, 0.9),
        nuisance.gain(good, 1.1),
        nuisance.noise(good, 5, 1),
        nuisance.shift(good, 1, 0),
        nuisance.shift(good, 0, -1),
        nuisance.glare(good, model.row_c, model.col_c, 15),
    ):
        assert invalid_reason(to_grey(image), check) == ""


def false_alarms(model: SensorModel, names: list[str], depths: tuple[float, ...]) -> list[str]:
    check, r = check_of(model), model.skin_radius_mm
    alarms = []
    for name in names:
        for depth in depths:
            for place in (0.0, 0.25 * r):
                image = simulated(model).frame((Press(OBJECTS[name](), place, 0.0, depth, 20.0),), 9).image
                if reason := invalid_reason(to_grey(image), check):
                    alarms.append(f"{name} {depth} mm at {place:.1f}: {reason}")
    return alarms


def test_no_contact_raises_a_false_alarm() -> None:
    assert false_alarms(HALF, sorted(OBJECTS), (3.0,)) == []


@pytest.mark.slow
@pytest.mark.parametrize("model", [FULL, TACTIP, *map(random_sensor, range(6))])
def test_no_contact_raises_a_false_alarm_on_other_sensors(model: SensorModel) -> None:
    assert false_alarms(model, sorted(OBJECTS), (1.0, 3.0, 5.0)) == []


def test_a_disc_outside_the_image_is_said() -> None:
    grey = np.random.default_rng(0).integers(0, 256, (40, 40), dtype=np.uint8)
    disc = Disc(500.0, 500.0, 10.0)
    assert invalid_reason(grey, frame_check(grey, disc_mask(40, 40, disc), disc)).startswith("disc")


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (7, 9), (8, 8), (9, 17)])
def test_tiny_images_have_an_answer(size: tuple[int, int]) -> None:
    grey = np.random.default_rng(0).integers(0, 256, size, dtype=np.uint8)
    disc = Disc(size[0] / 2, size[1] / 2, max(size) / 2)
    assert isinstance(invalid_reason(grey, frame_check(grey, disc_mask(*size, disc), disc)), str)


@pytest.mark.parametrize("shift_px", [5, 10, 20])
@pytest.mark.parametrize("row", [150, 240, 330])
def test_a_small_tear_is_seen_where_two_frames_meet(row: int, shift_px: int) -> None:
    made = Preprocessor(calibrated(FULL), PROFILES["fast"])
    torn = nuisance.torn(unloaded(FULL), unloaded(FULL, noise_seed=51), row, shift_px)
    assert re.match(rf"torn: row {row - 1} |torn or moved", made.invalid_reason(torn))
