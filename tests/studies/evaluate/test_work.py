from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from support.half_family import HALF_SENSOR, half_family

from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.studies.evaluate.scenes import scenes
from tacshade_edge.studies.evaluate.score import KnownTruth, Row, contact_iou, score_cloud
from tacshade_edge.studies.evaluate.sensors import reconstructor
from tacshade_edge.studies.evaluate.work import Evaluation, Plan, evaluate, time_profiles
from tacshade_edge.studies.parallel import ThisProcess
from tacshade_edge.studies.tables import csv_text
from tacshade_edge.types import Frame

pytestmark = pytest.mark.slow  # it renders and measures truths
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


def test_a_row_for_every_press_and_frame_without_contact(found: Evaluation) -> None:
    assert [r.object for r in found.rows] == ["ball"] * 3 + ["ring"] * 3 + ["none"] * 5
    assert {(r.sensor, r.profile) for r in found.rows} == {("half:default", "fast")}
    assert all(r.valid and r.contact and r.iou > 0.3 and r.me_mm < 2 for r in found.rows if r.object == "ball")
    assert not any(r.contact for r in found.rows if r.object == "none")
    assert [r.image for r in found.rows[-5:-3]] == ["", "light x0.8"]
    fit = found.calibrations[0].calibration.fit
    assert fit is not None
    assert fit.presses == 8


def test_the_same_plan_gives_the_same_bytes(found: Evaluation) -> None:
    assert csv_text(Row, evaluate(PLAN, ThisProcess(), quiet).rows) == csv_text(Row, found.rows)


def test_a_row_is_what_the_metrics_say_of_that_press(found: Evaluation) -> None:
    sensor = HALF_SENSOR.make()
    scene = scenes(sensor.model, None, "ring", (2.0,))[1]
    frame = sensor.frame((scene.press,), scene.noise_seed)
    truth = frame.truth()
    result = reconstructor(found.calibrations[0].calibration, "fast").step(Frame(0, 0, 0, frame.image))
    known = KnownTruth.of(truth)
    row, direct = found.rows[4], score_cloud(result.cloud.points_mm, known.points_mm, truth.depth_max_mm)
    assert (row.x_mm, row.y_mm, row.depth_mm) == (scene.press.x_mm, scene.press.y_mm, 2.0)
    assert (row.me_mm, row.sd_pct, row.backward_mm) == (direct.me_mm, 100 * direct.sd, direct.backward_mm)
    height = result.height
    cells = height.step_px * np.arange(len(height.contact))
    nearest = np.ix_(np.rint(height.row0 + cells).astype(int), np.rint(height.col0 + cells).astype(int))
    assert row.iou == contact_iou(height.contact, truth.contact[nearest])
    assert row.true_depth_mm == np.nanmax(truth.height_mm)


def test_references_alone(found: Evaluation) -> None:
    one = replace(PLAN, objects=("ball",), references=1, presses=0, null_frames=0)
    made = evaluate(one, ThisProcess(), quiet)
    assert made.calibrations[0].calibration.fit is None
    assert "found 1, expected 5" in made.calibrations[0].warnings[0]
    assert [r.depth_error_pct for r in made.rows] != [r.depth_error_pct for r in found.rows[:3]]


def test_profiles_are_timed_one_by_one(found: Evaluation) -> None:
    timings = time_profiles(replace(PLAN, profiles=("fast", "paper")), found.calibrations[0].calibration, quiet)
    assert list(timings) == ["fast", "paper"]
    assert 0 < timings["fast"].p50_ms < timings["paper"].p50_ms
    assert timings["fast"].steps == 6


def test_everything_is_pressed_by_default() -> None:
    plan = Plan((HALF_SENSOR,), ("fast",))
    assert set(plan.objects) == set(OBJECTS)
    assert (plan.references, plan.presses, plan.null_frames, len(plan.depths_mm)) == (8, 40, 20, 3)
