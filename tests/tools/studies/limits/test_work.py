from collections.abc import Iterator
from dataclasses import fields

import cv2
import numpy as np
import pytest
from support.calibrated_sensor import HALF
from support.half_family import HALF_SENSOR, half_family

from tacshade_edge.simulator.skin import press_skin
from tacshade_edge.studies.parallel import ThisProcess
from tacshade_edge.studies.tables import csv_text
from tools.studies.limits import picture
from tools.studies.limits.summary import text
from tools.studies.limits.work import Limits, Plan, ball_press, cylinder_press, limits

PLAN = Plan(
    (HALF_SENSOR,),
    ("fast", "accurate"),
    references=3,
    presses=10,
    null_frames=8,
    beyond_frames=5,
    ball_radii_mm=(6.0,),
    faint_depths_mm=(0.05, 1.0),
    faint_places=2,
    depths_mm=(3.0, 8.0),
    deep_places=1,
    pitches_mm=(1.9,),
    gaps_mm=(0.5, 6.0),
    widths_mm=(2.0,),
    fine_places=2,
    disturbed_places=1,
)


@pytest.mark.parametrize("place", [(0.0, 0.0), (3.0, -2.0)])
@pytest.mark.parametrize("height", [0.3, 4.0])
def test_a_press_reaches_the_wanted_greatest_height(place: tuple[float, float], height: float) -> None:
    for press in (ball_press(20, 6.0, *place, height), cylinder_press(20, 5.0, *place, height)):
        assert press_skin(20, HALF.skin_decay_mm, (press,)).height_mm.max() == pytest.approx(height, abs=0.01)


@pytest.fixture(scope="module")
def found() -> Iterator[Limits]:
    with half_family():
        yield limits(PLAN, ThisProcess(), lambda what, done, total: None)


@pytest.mark.slow
def test_every_question_has_its_rows(found: Limits) -> None:
    assert [len(rows) for _, rows in found.tables()] == [26, 8, 8, 12, 12]
    assert {r.profile for _, rows in found.tables() for r in rows} == {"fast", "accurate"}
    assert [r.contact for r in found.faint if r.profile == "accurate"] == [False, True] * 2
    assert not any(r.contact for r in found.nulls if r.disturbance == "nothing")
    assert all(r.clean_mm > 1 for r in found.disturbed)
    wide = [r for r in found.fine if r.size_mm == 6.0 and r.profile == "accurate"]
    assert all(r.objects == 2 and r.found_height_mm > 0.3 * r.true_height_mm > 0.1 for r in wide)


@pytest.mark.slow
def test_the_text_and_the_plots_show_every_profile(found: Limits) -> None:
    written = text(found, PLAN)
    assert written.count("| accurate |") >= 12
    assert "all of these" in written
    made = picture.draw(found)
    assert sorted(made) == [f"limits_{k}.png" for k in ("depth", "detection", "disturbed", "resolution")]
    for content in made.values():
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        assert (image.min(axis=2) < 235).mean() > 0.005
    for _, rows in found.tables():
        header = csv_text(type(rows[0]), rows).splitlines()[0]
        assert header.split(",") == [field.name for field in fields(rows[0])]


@pytest.mark.slow
def test_the_same_plan_gives_the_same_rows(found: Limits) -> None:
    with half_family():
        again = limits(PLAN, ThisProcess(), lambda what, done, total: None)
    assert [rows for _, rows in again.tables()] == [rows for _, rows in found.tables()]
