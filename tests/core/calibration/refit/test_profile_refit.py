from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.calibrated_sensor import HALF, calibrated, pressed, presses, references, sensor_of, simulated

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.presses.press_selection import MIN_PRESSES
from tacshade_edge.core.calibration.refit.gain import stated_ball
from tacshade_edge.core.calibration.refit.profile_refit import Refit, refit_profile
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import load_networks, make_reconstructor
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.types import Frame

pytestmark = pytest.mark.slow


def refitted(table: list[KnownPress], profile: str = "fast") -> Refit:
    unloaded = calibrated(count=0)
    refit = refit_profile(unloaded, PROFILES[profile], load_networks()[profile], table)
    assert refit is not None
    return refit


@pytest.mark.parametrize("name", ["fast", "balanced", "accurate"])
def test_every_learned_profile_finds_the_presses(name: str) -> None:
    fit = calibrated().fit
    assert fit is not None
    found = fit.profiles[name]
    assert found.presses >= 18
    # What good presses give at most: 0.30 mm is the bound of the grade `good` (quality.py).
    assert 0 < found.depth_mae_mm < 0.30
    assert found.depth_mae_mm < found.depth_worst_mm


def test_false_depths_have_a_large_error() -> None:
    depths = [press.depth_mm for press in presses()]
    np.random.default_rng(1).shuffle(depths)
    shuffled = [replace(press, depth_mm=depth) for press, depth in zip(presses(), depths, strict=True)]
    honest, false = (refitted(list(table)).fit.depth_mae_mm for table in (presses(), shuffled))
    assert false > 4 * honest


def test_the_error_is_that_on_presses_of_which_the_refit_knows_nothing() -> None:
    """Each third of the presses against a refit to the rest, as its leave-one-out error says.

    Twenty errors of like size have a mean that is known to a fifth of it; a factor of 1.5 is two such parts and more.
    """
    geometry, errors, promised = calibrated(count=0).geometry, [], []
    for part in range(3):
        refit = refitted([press for k, press in enumerate(presses()) if k % 3 != part])
        made = make_reconstructor(replace(calibrated(count=0), factors={"fast": refit.factor}), PROFILES["fast"])
        promised.append(refit.fit.depth_mae_mm)
        for press in presses()[part::3]:
            at = stated_ball(geometry, press.x_mm or 0, press.y_mm or 0, press.depth_mm, press.radius_mm)
            found_mm = made.step(Frame(0, 0, 0, press.image)).depth_max_mm
            errors.append(abs(found_mm - at.depth_max_mm(geometry.skin_radius_mm)))
    assert 1 / 1.5 < np.mean(errors) / np.mean(promised) < 1.5


def test_presses_that_do_not_vary_still_calibrate() -> None:
    one = simulated(HALF)
    same = [
        KnownPress(str(k), one.frame((Press(ball(6.0), 0, 0, 2.0),), k).image, 6.0, 2.0, 0.0, 0.0)
        for k in range(MIN_PRESSES)
    ]
    fitted = calibrate(sensor_of(HALF), references(), same, networks=load_networks()).calibration
    made = make_reconstructor(fitted, PROFILES["fast"])
    assert made.step(Frame(0, 0, 0, pressed("ball", 2.0).image)).depth_max_mm == pytest.approx(2.0, rel=0.1)
    assert all(np.isfinite(factor) for factor in fitted.factors.values())


def test_presses_without_a_place_refit_about_as_well() -> None:
    stated = refitted(list(presses()), "accurate").fit
    located = refitted([replace(press, x_mm=None, y_mm=None) for press in presses()], "accurate").fit
    assert located.presses >= 18
    assert located.depth_mae_mm < stated.depth_mae_mm + 0.1


def test_presses_without_contact_refit_nothing() -> None:
    unloaded = calibrated(count=0)
    free = [replace(press, image=references()[0]) for press in presses()]
    assert refit_profile(unloaded, PROFILES["fast"], load_networks()["fast"], free) is None
