from __future__ import annotations

import numpy as np
import pytest
from support.calibrated_sensor import HALF, calibrated, presses, references, sensor_of, unloaded

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.presses.press_selection import MIN_PRESSES
from tacshade_edge.errors import ConfigError
from tacshade_edge.inference.network import load_networks

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
    outside = np.hypot(np.arange(240)[:, None] - HALF.row_c, np.arange(320)[None, :] - HALF.col_c) > 104
    assert not calibration.reference_white[outside].any()


def test_references_that_cannot_be_used() -> None:
    with pytest.raises(ConfigError, match="no reference image"):
        calibrate(SENSOR, [])
    with pytest.raises(ConfigError, match="reference 2: found 320x239 px, expected 320x240 px as in the first"):
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
    assert any("close together" in advice for advice in quality.advice)


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
