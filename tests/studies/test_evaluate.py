"""The sensors, scenes and rows of an evaluation."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from support.half_family import HALF_SENSOR, half_family

from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator.model import random_model
from tacshade_edge.studies.evaluate.score import Row
from tacshade_edge.studies.evaluate.sensors import SensorName, calibrated
from tacshade_edge.studies.evaluate.work import (
    DEPTHS_MM,
    RINGS,
    Evaluation,
    Plan,
    evaluate,
    places,
    scenes,
    time_profiles,
)
from tacshade_edge.studies.parallel import ThisProcess
from tacshade_edge.studies.tables import csv_text


@pytest.mark.parametrize("text", ["default", "5", "0", "8999"])
def test_a_name_is_written_as_it_is_read(text: str) -> None:
    assert str(SensorName.parse(text)) == text
    assert SensorName.parse(f"tacshade:{text}") == SensorName.parse(text)


@pytest.mark.parametrize("text", ["", "x", "-1", "1.5", "teapot:3", "tacshade:", ":5", "٣", "99999999999"])
def test_what_is_no_sensor_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        SensorName.parse(text)


@pytest.mark.slow  # likewise
def test_a_sensor_that_cannot_be_calibrated_is_named() -> None:
    with pytest.raises(ConfigError, match=r"sensor 5: found 2 presses, expected at least 8"):
        calibrated(SensorName.parse("5"), references=1, presses=2)


def test_every_place_and_depth_once_and_the_same_again() -> None:
    model = random_model(5)
    made = scenes(model, 5, "cube")
    grid = [((s.press.x_mm, s.press.y_mm, s.press.rotation_deg), s.press.depth_mm) for s in made]
    assert grid == list(itertools.product(places(model, 5), DEPTHS_MM))
    assert len(grid) == len(set(grid)) == 9
    assert len({s.noise_seed for s in made}) == 9
    assert {s.press.scale for s in made} == {model.skin_radius_mm / 20}
    for (low, high), (x, y, _) in zip(RINGS, places(model, 5), strict=True):
        assert low - 1e-3 <= np.hypot(x, y) / model.skin_radius_mm <= high + 1e-3
    assert places(model, 6) != places(model, 5)


PLAN = Plan(
    (HALF_SENSOR,), ("fast",), objects=("ball", "ring"), references=3, presses=8, depths_mm=(2.0,), null_frames=5
)


def quiet(what: str, done: int, total: int) -> None:
    assert 0 <= done <= total


@pytest.fixture(scope="module", autouse=True)
def family() -> Iterator[None]:
    with half_family():
        yield


@pytest.fixture(scope="module")
def found() -> Evaluation:
    return evaluate(PLAN, ThisProcess(), quiet)


@pytest.mark.slow
def test_a_row_for_every_press_and_frame_without_contact(found: Evaluation) -> None:
    assert [r.object for r in found.rows] == ["ball"] * 3 + ["ring"] * 3 + ["none"] * 5
    assert {(r.sensor, r.profile) for r in found.rows} == {("half:default", "fast")}
    assert all(r.valid and r.contact and r.iou > 0.3 and r.me_mm < 2 for r in found.rows if r.object == "ball")
    assert not any(r.contact for r in found.rows if r.object == "none")
    assert [r.image for r in found.rows[-5:-3]] == ["", "light x0.8"]
    fit = found.calibrations[0].calibration.fit
    assert fit is not None
    assert fit.presses == 8


@pytest.mark.slow
def test_the_same_plan_gives_the_same_bytes(found: Evaluation) -> None:
    again = evaluate(replace(PLAN, objects=("ball",), null_frames=0), ThisProcess(), quiet)
    assert csv_text(Row, again.rows) == csv_text(Row, found.rows[:3])


@pytest.mark.slow
def test_references_alone(found: Evaluation) -> None:
    one = replace(PLAN, objects=("ball",), references=1, presses=0, null_frames=0)
    made = evaluate(one, ThisProcess(), quiet)
    assert made.calibrations[0].calibration.fit is None
    assert "found 1, expected 5" in made.calibrations[0].warnings[0]
    assert [r.depth_error_pct for r in made.rows] != [r.depth_error_pct for r in found.rows[:3]]


@pytest.mark.slow
def test_profiles_are_timed_one_by_one(found: Evaluation) -> None:
    timings = time_profiles(replace(PLAN, profiles=("fast", "paper")), found.calibrations[0].calibration, quiet)
    assert list(timings) == ["fast", "paper"]
    assert 0 < timings["fast"].p50_ms < timings["paper"].p50_ms
    assert timings["fast"].steps == 6
