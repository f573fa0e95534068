from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.calibrated_sensor import (
    HALF,
    calibrated,
    pressed,
    presses,
    references,
    sensor_of,
    simulated,
    step,
    unloaded,
)

from tacshade_edge.core.calibration.calibrate import MIN_PRESSES, BallPress, Calibrated, calibrate, rezero
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.devices.weights.network import load_networks, make_reconstructor
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.types import U8, Frame

SENSOR = sensor_of(HALF)


def fitted(table: tuple[BallPress, ...] | list[BallPress]) -> Calibrated:
    return calibrate(SENSOR, references(), table, networks=load_networks())


def loaded(depth_mm: float, x_mm: float, model: SensorModel = HALF) -> list[U8]:
    sensor = simulated(model)
    return [sensor.frame((Press(ball(6.0), x_mm, 0.0, depth_mm),), k).image for k in range(3)]


def test_references_alone_give_what_images_tell() -> None:
    result = calibrate(SENSOR, references())
    calibration = result.calibration
    assert result.warnings == ()
    assert (calibration.image_height_px, calibration.image_width_px) == (240, 320)
    assert calibration.geometry.disc.radius_px == pytest.approx(HALF.disc_radius_px, rel=0.005)
    assert not calibration.factors
    assert calibration.alpha == 15.0
    assert calibration.fit == {}
    assert 0.2 < calibration.noise_grey < 3
    outside = np.hypot(np.arange(240)[:, None] - HALF.row_c, np.arange(320)[None, :] - HALF.col_c) > 104
    assert not calibration.reference_white[outside].any()


def test_noise_is_measured_from_the_references() -> None:
    noisy = [nuisance.noise(image, 12, k) for k, image in enumerate(references())]
    assert calibrate(SENSOR, noisy).calibration.noise_grey > 1.5 * calibrated(count=0).noise_grey


def test_few_references_are_said() -> None:
    (warning,) = calibrate(SENSOR, references()[:1]).warnings
    assert warning.startswith("1 reference: noise assumed")


def test_references_that_cannot_be_used() -> None:
    with pytest.raises(ConfigError, match="no reference image"):
        calibrate(SENSOR, [])
    with pytest.raises(ConfigError, match="reference 2 is 320x239 px, the first is 320x240"):
        calibrate(SENSOR, [references()[0], references()[1][:-1]])
    for image in (unloaded() * 0, unloaded() * 0 + 255, np.zeros((1, 1), np.uint8)):
        with pytest.raises(ConfigError, match="in the reference"):
            calibrate(SENSOR, [image] * 3)


@pytest.mark.parametrize("x_mm", [0.0, 5.0])
def test_a_reference_under_load_is_refused_or_allowed(x_mm: float) -> None:
    with pytest.raises(ConfigError, match=r"taken under load.*--allow-loaded-reference"):
        calibrate(SENSOR, loaded(3.0, x_mm))
    (warning,) = calibrate(SENSOR, loaded(3.0, x_mm), allow_loaded_reference=True).warnings
    assert "taken under load" in warning


@pytest.mark.slow
@pytest.mark.parametrize("height", [240, 480])
def test_load_is_told_from_none_on_other_sensors(height: int) -> None:
    passed = []
    for seed in range(12):
        model = random_model(seed, height, height * 4 // 3)
        calibrate(sensor_of(model), references(model, 3))  # never refused
        for x_mm in (0.0, 5.0):
            try:
                calibrate(sensor_of(model), loaded(3.0, x_mm, model))
            except ConfigError:
                continue
            passed.append((seed, x_mm))
    assert len(passed) <= 1  # 8.7 mm² of 9 were found of one ball


def test_presses_refit_every_learned_profile_and_give_a_real_error() -> None:
    made = calibrated()
    assert sorted(made.factors) == ["accurate", "balanced", "fast"]
    assert made.fit["presses"] == 20
    for name in made.factors:
        assert made.fit[f"{name}_presses"] >= 18
        assert 0 < made.fit[f"{name}_depth_mae_mm"] < 0.35
        assert made.fit[f"{name}_depth_worst_mm"] >= made.fit[f"{name}_depth_mae_mm"]
    assert made.fit["position_mae_mm"] < 2.5
    assert not calibrate(SENSOR, references(), presses()).calibration.factors
    assert not calibrated(count=0).factors


def test_cross_validation_finds_out_false_depths() -> None:
    depths = [press.depth_mm for press in presses()]
    np.random.default_rng(1).shuffle(depths)
    shuffled = [replace(press, depth_mm=depth) for press, depth in zip(presses(), depths, strict=True)]
    honest, false = (fitted(table).calibration.fit["accurate_depth_mae_mm"] for table in (presses(), shuffled))
    assert false > 2 * honest


def test_cross_validation_is_near_the_error_on_presses_that_it_never_saw() -> None:
    calibration = fitted(presses()[::2] + presses()[1::4]).calibration
    made = make_reconstructor(calibration, PROFILES["fast"])
    unseen = presses()[3::4]
    errors = [abs(made.step(Frame(0, 0, 0, p.image)).depth_max_mm - p.depth_mm) for p in unseen]
    assert np.mean(errors) < 3 * calibration.fit["accurate_depth_mae_mm"]


def test_presses_that_do_not_vary_still_calibrate() -> None:
    one = simulated(HALF)
    same = [
        BallPress(str(k), one.frame((Press(ball(6.0), 0, 0, 2.0),), k).image, 6.0, 2.0, 0.0, 0.0)
        for k in range(MIN_PRESSES)
    ]
    made = make_reconstructor(fitted(same).calibration, PROFILES["fast"])
    assert made.step(Frame(0, 0, 0, pressed("ball", 2.0).image)).depth_max_mm == pytest.approx(2.0, rel=0.1)
    assert all(np.isfinite(factor) for factor in made.calibration.factors.values())


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
    for image, said in {
        "size": (presses()[0].image[:-2], "320x238 px, the reference is 320x240"),
        "black": (presses()[0].image * 0, "not usable: black"),
    }.values():
        with pytest.raises(ConfigError, match=f"press 0: {said}"):
            fitted([replace(presses()[0], image=image), *presses()[1:]])


def test_a_good_set_is_called_good() -> None:
    result = fitted(presses())
    assert result.warnings == ()
    assert result.verdict.grade == "good"
    assert result.calibration.fit["agreement_mae_mm"] < 0.2
    assert calibrate(SENSOR, references()).verdict.grade == "uncalibrated"


def test_a_press_that_disagrees_is_named_and_left_out() -> None:
    wrong = replace(presses()[6], depth_mm=presses()[6].depth_mm + 2.5)
    result = fitted([*presses()[:6], wrong, *presses()[7:]])
    (warning,) = result.warnings
    assert warning.startswith(f"press 6: depth {wrong.depth_mm:.2f} mm is stated, ")
    assert warning.endswith("; left out")
    assert result.calibration.fit["presses"] == 19


def test_too_many_that_disagree_are_refused_with_the_likely_reason() -> None:
    swapped = [replace(press, x_mm=press.y_mm, y_mm=press.x_mm) for press in presses()]
    with pytest.raises(ConfigError, match=r"of 20 presses cannot be used; .* if x and y are swapped; press \d+: x "):
        fitted(swapped)


def test_a_wrong_unit_is_said() -> None:
    in_cm = fitted([replace(press, depth_mm=press.depth_mm / 10) for press in presses()])
    assert any(warning.endswith("are the depths in cm?") for warning in in_cm.warnings)


def test_clustered_presses_say_what_is_missing() -> None:
    near = sorted(presses(), key=lambda p: (p.x_mm or 0) ** 2 + (p.y_mm or 0) ** 2)[:MIN_PRESSES]
    result = fitted(near)
    assert result.verdict.grade != "good"
    assert any("close together" in advice for advice in result.verdict.advice)


def moved(image: U8, px: int) -> U8:
    return nuisance.shift(image, 0, px)


def test_a_camera_that_moved_at_a_press_or_for_all_of_them() -> None:
    one = [replace(presses()[0], image=moved(presses()[0].image, 1)), *presses()[1:]]
    assert fitted(one).warnings == ("press 0: the image moved by 1.0 px since the references",)
    far = [replace(presses()[0], image=moved(presses()[0].image, 5)), *presses()[1:]]
    (warning,) = fitted(far).warnings
    assert warning.startswith("press 0: the image moved by 5.0 px")
    assert warning.endswith("since the references; left out")
    with pytest.raises(ConfigError, match=r"20 of 20 presses cannot be used; press 0: the image moved by"):
        fitted([replace(press, image=moved(press.image, 5)) for press in presses()])


def test_other_light_at_a_press_is_said() -> None:
    dim = [replace(presses()[0], image=nuisance.gain(presses()[0].image, 0.7)), *presses()[1:]]
    (warning,) = fitted(dim).warnings
    assert warning.startswith("press 0: 0.7")
    assert warning.endswith("times the light since the references")


def test_references_that_differ_from_each_other() -> None:
    others = list(references()[1:])
    (warning,) = calibrate(SENSOR, [moved(references()[0], 1), *others[:3]]).warnings[:1]
    assert warning == "reference 2: the image moved by 1.0 px against reference 1"
    with pytest.raises(ConfigError, match=r"reference 3: the image moved by 5\.0 px since reference 1; fix the camera"):
        calibrate(SENSOR, [*others[:2], moved(others[2], 5)])
    (warning,) = calibrate(SENSOR, [*others, nuisance.gain(references()[0], 0.7)]).warnings
    assert warning.startswith("reference 5: 0.7")
    one_loaded = [*others, simulated(HALF).frame((Press(ball(6.0), 3, 2, 1.5),), 9).image]
    with pytest.raises(ConfigError, match="reference 5: seems pressed"):
        calibrate(SENSOR, one_loaded)
    assert any("seems pressed" in said for said in calibrate(SENSOR, one_loaded, (), True).warnings)


def test_presses_that_show_no_contact_are_refused() -> None:
    with pytest.raises(ConfigError, match="no contact"):
        fitted([replace(press, image=unloaded(noise_seed=60 + k)) for k, press in enumerate(presses())])


def test_a_new_reference_keeps_everything_else() -> None:
    dimmer = [nuisance.gain(unloaded(noise_seed=60 + k), 0.8) for k in range(3)]
    renewed = rezero(calibrated(), dimmer)
    assert renewed.crc32 == 0
    assert renewed.reference_grey.mean() < 0.85 * calibrated().reference_grey.mean()
    for name in ("geometry", "polarity", "pitch_px", "alpha", "fit"):
        assert getattr(renewed, name) == getattr(calibrated(), name)
    assert renewed.factors == calibrated().factors
    image = pressed("ball", 3.0).image
    depth_mm = (
        make_reconstructor(renewed, PROFILES["fast"]).step(Frame(0, 0, 0, nuisance.gain(image, 0.8))).depth_max_mm
    )
    assert depth_mm == pytest.approx(step("fast", image).depth_max_mm, rel=0.1)


@pytest.mark.parametrize(
    ("images", "said"),
    [
        ([], "no image"),
        ([unloaded() * 0], "reference refused: black"),
        ([unloaded(), unloaded()[:-1]], "reference refused: size"),
        (loaded(3.0, 0.0), "reference refused: .*under load"),
        (loaded(3.0, 6.0), "reference refused: .*under load"),
        ([nuisance.shift(unloaded(), 0, 4)] * 3, "reference refused: the image moved by 4.0 px; .*calibrate again"),
        ([nuisance.defocus(unloaded(), 2.5)] * 3, "reference refused: 0.* times the contrast"),
    ],
    ids=["none", "black", "size", "load in the middle", "load", "moved", "blurred"],
)
def test_a_new_reference_that_cannot_be_used(images: list[U8], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        rezero(calibrated(), images)


def test_a_load_may_be_allowed() -> None:
    assert rezero(calibrated(), loaded(3.0, 6.0), allow_loaded=True).crc32 == 0


def test_presses_without_a_place_refit_about_as_well() -> None:
    somewhere = [replace(press, x_mm=None, y_mm=None) for press in presses()]
    made = calibrate(SENSOR, references(), somewhere, networks=load_networks()).calibration
    assert made.fit["accurate_presses"] >= 18
    assert made.fit["accurate_depth_mae_mm"] < calibrated().fit["accurate_depth_mae_mm"] + 0.1
