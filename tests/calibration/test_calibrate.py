from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest

from support.calibrated_sensor import HALF, calibrated, presses, references, sensor_of, unloaded
from tacshade_edge.calibration.calibrate import FINE_PITCH_PX, CalibrationResult, calibrate
from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.presses.press_selection import MIN_PRESSES
from tacshade_edge.calibration.sentences import sentence
from tacshade_edge.errors import ConfigError
from tacshade_edge.sensor.inference.network import load_networks

pytestmark = pytest.mark.slow

SENSOR = sensor_of(HALF)


def test_references_alone_give_what_images_tell() -> None:
    result = calibrate(SENSOR, references())
    calibration = result.calibration
    assert result.warnings == ()
    assert (calibration.image_height_px, calibration.image_width_px) == (240, 320)
    assert calibration.geometry.disc.radius_px == pytest.approx(HALF.disc_radius_px, rel=0.005)
    assert not calibration.factors
    assert calibration.alpha == 15.0
    assert calibration.fit is None
    assert 0.2 < calibration.noise_grey < 3
    outside = (
        np.hypot(np.arange(240)[:, None] - HALF.row_c, np.arange(320)[None, :] - HALF.col_c) > 104
    )
    assert not calibration.reference_white[outside].any()


def test_a_pattern_too_fine_for_the_images_is_named() -> None:
    small = [
        np.asarray(cv2.resize(image, (160, 120), interpolation=cv2.INTER_AREA))
        for image in references()
    ]
    result = calibrate(SENSOR, small)
    assert result.calibration.pitch_px < FINE_PITCH_PX
    (fine,) = [each for each in result.warnings if each.code is FindingCode.FINE_PATTERN]
    assert "expected at least 6" in sentence(fine)


def test_references_that_cannot_be_used() -> None:
    with pytest.raises(ConfigError, match="no reference image"):
        calibrate(SENSOR, [])
    with pytest.raises(
        ConfigError, match="reference 2: found 320x239 px, expected 320x240 px as in the first"
    ):
        calibrate(SENSOR, [references()[0], references()[1][:-1]])
    for image in (unloaded() * 0, unloaded() * 0 + 255, np.zeros((1, 1), np.uint8)):
        with pytest.raises(ConfigError, match="in the reference"):
            calibrate(SENSOR, [image] * 3)


def test_a_good_set_is_called_good() -> None:
    result = calibrate(SENSOR, references(), presses(), networks=load_networks())
    assert result.warnings == ()
    assert result.quality.grade == "good"
    assert result.quality.advice == ()
    assert calibrate(SENSOR, references()).quality.grade == "uncalibrated"


def test_clustered_presses_say_what_is_missing() -> None:
    near = sorted(presses(), key=lambda p: (p.x_mm or 0) ** 2 + (p.y_mm or 0) ** 2)[:MIN_PRESSES]
    quality = calibrate(SENSOR, references(), near, networks=load_networks()).quality
    assert quality.grade == "fair"
    assert FindingCode.CLOSE_TOGETHER in {advice.code for advice in quality.advice}


def test_the_fit_is_of_the_presses_that_were_used() -> None:
    fit = calibrated().fit
    assert fit is not None
    assert fit.presses == 20
    assert fit.agreement_mae_mm < 0.2
    assert 0 < fit.position_mae_mm < 2.5
    assert sorted(fit.profiles) == sorted(calibrated().factors) == ["accurate", "balanced", "fast"]
    alone = calibrate(SENSOR, references(), presses()).calibration
    assert alone.fit is not None
    assert not alone.fit.profiles
    assert not alone.factors


def codes(findings: Sequence[CalibrationFinding]) -> list[tuple[str, FindingCode]]:
    return [(each.press, each.code) for each in findings]


def calibrated_at(radius_mm: float) -> CalibrationResult:
    """`HALF` as if it had another radius; depths too great, one depth and one place wrong."""
    by = radius_mm / HALF.skin_radius_mm
    stated = sensor_of(
        replace(
            HALF, skin_radius_mm=radius_mm, camera_distance_mm=by * (HALF.camera_distance_mm or 0)
        )
    )

    def press(k: int, p: KnownPress) -> KnownPress:
        return replace(
            p,
            radius_mm=by * p.radius_mm,
            depth_mm=by * (p.depth_mm + 1.0 + 2.5 * (k == 6)),
            x_mm=by * ((p.x_mm or 0.0) + 4.5 * (k == 9)),
            y_mm=by * (p.y_mm or 0.0),
        )

    table = [press(k, p) for k, p in enumerate(presses())]
    return calibrate(
        stated, references(), table, networks={"accurate": load_networks()["accurate"]}
    )


def test_a_sensor_that_is_scaled_as_a_whole_is_calibrated_alike() -> None:
    """It shows the same images."""
    nominal, there = calibrated_at(HALF.skin_radius_mm), calibrated_at(12.0)
    assert codes(there.warnings) == codes(nominal.warnings)
    assert ("", FindingCode.DEPTHS_TOO_GREAT) in codes(there.warnings)
    assert there.quality.grade == nominal.quality.grade
    assert codes(there.quality.advice) == codes(nominal.quality.advice)
    assert there.calibration.factors == pytest.approx(nominal.calibration.factors, rel=1e-4)
    by = 12.0 / HALF.skin_radius_mm
    fit, expected = there.calibration.fit, nominal.calibration.fit
    assert fit
    assert expected
    assert fit.presses == expected.presses
    assert fit.agreement_mae_mm == pytest.approx(by * expected.agreement_mae_mm, rel=1e-4)
    assert fit.profiles["accurate"].depth_worst_mm == pytest.approx(
        by * expected.profiles["accurate"].depth_worst_mm, rel=1e-3
    )
