from __future__ import annotations

from dataclasses import replace

import pytest
from support.calibrated_sensor import HALF, presses, references, sensor_of, unloaded

from tacshade_edge.core.calibration.calibrate import CalibrationResult, calibrate
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.press_selection import MIN_PRESSES
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator import nuisance
from tacshade_edge.types import U8


def fitted(table: tuple[KnownPress, ...] | list[KnownPress]) -> CalibrationResult:
    return calibrate(sensor_of(HALF), references(), table)


def shifted(image: U8, px: int) -> U8:
    return nuisance.shift(image, 0, px)


def test_too_few_presses() -> None:
    with pytest.raises(ConfigError, match=f"7 presses: at least {MIN_PRESSES} are needed"):
        fitted(presses()[:7])


@pytest.mark.parametrize("depth_mm", [0.0, -1.0, 20.0, 1e9, float("nan"), float("inf")])
def test_a_depth_that_cannot_be(depth_mm: float) -> None:
    with pytest.raises(ConfigError, match=r"press 0: depth .* expected 0 < depth < 20"):
        fitted([replace(presses()[0], depth_mm=depth_mm), *presses()[1:]])


@pytest.mark.parametrize("radius_mm", [0.0, -1.0, float("nan")])
def test_a_ball_that_cannot_be(radius_mm: float) -> None:
    with pytest.raises(ConfigError, match=r"press 0: .*expected .*a radius above 0"):
        fitted([replace(presses()[0], radius_mm=radius_mm), *presses()[1:]])


def test_press_images_that_cannot_be_used() -> None:
    for image, reason in {
        "size": (presses()[0].image[:-2], "320x238 px, the reference is 320x240"),
        "black": (presses()[0].image * 0, "not usable: black"),
    }.values():
        with pytest.raises(ConfigError, match=f"press 0: {reason}"):
            fitted([replace(presses()[0], image=image), *presses()[1:]])


def test_a_press_that_disagrees_is_named_and_left_out() -> None:
    wrong = replace(presses()[6], depth_mm=presses()[6].depth_mm + 2.5)
    result = fitted([*presses()[:6], wrong, *presses()[7:]])
    (warning,) = result.warnings
    assert warning.startswith(f"press 6: depth {wrong.depth_mm:.2f} mm is stated, ")
    assert warning.endswith("; left out")
    assert result.calibration.fit is not None
    assert result.calibration.fit.presses == 19


def test_too_many_that_disagree_are_refused_with_the_likely_reason() -> None:
    swapped = [replace(press, x_mm=press.y_mm, y_mm=press.x_mm) for press in presses()]
    with pytest.raises(ConfigError, match=r"of 20 presses cannot be used; .* if x and y are swapped; press \d+: x "):
        fitted(swapped)


def test_a_wrong_unit_is_hinted() -> None:
    in_cm = fitted([replace(press, depth_mm=press.depth_mm / 10) for press in presses()])
    assert any(warning.endswith("are the depths in cm?") for warning in in_cm.warnings)


def test_a_camera_that_moved_at_a_press_or_for_all_of_them() -> None:
    one = [replace(presses()[0], image=shifted(presses()[0].image, 1)), *presses()[1:]]
    assert fitted(one).warnings == ("press 0: the image moved by 1.0 px since the references",)
    far = [replace(presses()[0], image=shifted(presses()[0].image, 5)), *presses()[1:]]
    (warning,) = fitted(far).warnings
    assert warning.startswith("press 0: the image moved by 5.0 px")
    assert warning.endswith("since the references; left out")
    with pytest.raises(ConfigError, match=r"20 of 20 presses cannot be used; press 0: the image moved by"):
        fitted([replace(press, image=shifted(press.image, 5)) for press in presses()])


def test_other_light_at_a_press_is_a_warning() -> None:
    dim = [replace(presses()[0], image=nuisance.gain(presses()[0].image, 0.7)), *presses()[1:]]
    (warning,) = fitted(dim).warnings
    assert warning.startswith("press 0: 0.7")
    assert warning.endswith("times the light since the references")


def test_presses_that_show_no_contact_are_refused() -> None:
    with pytest.raises(ConfigError, match="no contact"):
        fitted([replace(press, image=unloaded(noise_seed=60 + k)) for k, press in enumerate(presses())])
