"""Short trainings of a simulated sensor's presses; what a whole one is worth says tools/studies/fit.py."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from support.calibrated_sensor import calibrated, presses
from support.result_page import Page

from tacshade_edge.core.profiles import DEFAULT, PROFILES
from tacshade_edge.errors import ConfigError
from tacshade_edge.inference.network import make_reconstructor, shipped_layout
from tacshade_edge.types import Calibration, Frame

if TYPE_CHECKING:
    from tacshade_edge.fitting.fit import FitResult

# Found, not imported: that takes whoever only collects this two seconds.
pytestmark = [
    pytest.mark.fit,
    pytest.mark.skipif(find_spec("torch") is None, reason="PyTorch (the extra fit) is not installed"),
]
STEPS = "tacshade_edge.fitting.training.STEPS"


def fit(*given: Any) -> FitResult:
    from tacshade_edge.fitting.fit import fit as wanted

    return wanted(*given)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(STEPS, 40)


def only(*profiles: str) -> Calibration:
    factors = {name: factor for name, factor in calibrated().factors.items() if name in profiles}
    return replace(calibrated(), factors=factors)


def wrong(part: float) -> Calibration:
    """As if the shipped network were off: its factor is."""
    return replace(only("fast"), factors={"fast": part * calibrated().factors["fast"]})


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_what_is_better_on_presses_that_were_held_out_is_kept_and_runs() -> None:
    result = fit(wrong(0.8), presses(), lambda _: None)
    (report,) = result.profiles
    made = result.calibration.fitted["fast"]
    assert report.kept
    assert made.error_mm < made.shipped_error_mm
    assert made.held_out == 4
    assert made.error_scale is not None
    assert 0.2 < made.error_scale < 3
    assert made.layout == shipped_layout("fast")
    assert f"off by {made.error_mm:.2f} mm" in report.line
    press = presses()[2]
    frame = Frame(0, 0, 0, press.image)
    found = make_reconstructor(result.calibration, PROFILES["fast"]).step(frame).depth_max_mm
    before = make_reconstructor(wrong(0.8), PROFILES["fast"]).step(frame).depth_max_mm
    right = make_reconstructor(calibrated(), PROFILES["fast"]).step(frame).depth_max_mm
    assert abs(found - right) < abs(before - right)


@pytest.mark.slow
def test_what_is_no_better_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(STEPS, 4)
    monkeypatch.setattr("tacshade_edge.fitting.training.RATE", 1e-12)
    result = fit(only("fast"), presses(), lambda _: None)
    assert result.calibration.fitted == {}
    assert "the shipped network stays" in result.profiles[0].line


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_it_is_the_same_every_time() -> None:
    weights = [fit(wrong(0.8), presses(), lambda _: None).calibration.fitted["fast"].weights for _ in range(2)]
    np.testing.assert_array_equal(*weights)


@pytest.mark.slow
def test_the_default_profile_is_the_first_and_its_time_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(STEPS, 4)
    monkeypatch.setattr("tacshade_edge.fitting.fit._SAY_S", 0.0)
    said: list[str] = []
    result = fit(only("fast", DEFAULT), presses(), said.append)
    assert [report.profile for report in result.profiles] == [DEFAULT, "fast"]
    assert said[0].startswith(f"fit of {DEFAULT} (1 of 2): step 1 of 4, ")
    assert said[-1] == "fit of fast (2 of 2): step 4 of 4, 0 s left at most"
    assert "flat ends" in result.advice[0]
    assert result.advice[1] == "take 20 more presses"


@pytest.mark.parametrize(
    ("pressed", "dragged", "gain"),
    [
        ((0.3, 0.2), (0.4, 0.4), "1 %"),
        ((0.3, 0.2), (), "1 %"),
        ((0.3, 0.31), (0.4, 0.38), "1 %"),
        ((0.3, 0.299), (0.4, 0.4), "0 %"),
        ((0.3, 0.28), (0.4, 0.43), None),
        ((0.3, 0.3), (), None),
    ],
)
def test_a_fit_is_kept_if_it_helps_presses_and_drags_together(
    pressed: tuple[float, ...], dragged: tuple[float, ...], gain: str | None
) -> None:
    from tacshade_edge.fitting.fit import ProfileReport

    before, after = ({"ball": mm} for mm in pressed)
    was, now = ({"ball": mm} for mm in dragged) if dragged else ({}, {})
    report = ProfileReport("fast", before, after, was, now)
    assert report.kept == (gain is not None)
    assert ("dragged, " in report.line) == bool(dragged)
    promise = f"; expect objects that you did not press to gain {gain}"
    assert report.line.endswith(promise if gain else "; that is no better, so the shipped network stays")


def test_a_fit_promises_what_the_page_measured() -> None:
    from tacshade_edge.fitting.fit import GAIN_ELSEWHERE_PCT

    means = {name: float(Page("fit").cells("half of each mean", name)[0]) for name in GAIN_ELSEWHERE_PCT}
    assert {name: round(100 * (1 - mean)) for name, mean in means.items()} == GAIN_ELSEWHERE_PCT


def test_too_few_presses_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"--fit: found 15 usable presses, expected at least 16"):
        fit(calibrated(), presses()[:15], lambda _: None)
