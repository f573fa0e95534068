"""The studies of the paper's two experiments, and the search for its sensor."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.lab.simulator.press import OBJECTS, PAPER_OBJECTS
from tacshade_edge.lab.simulator.sensor_model import random_model
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.lab.studies.stitch.map_truth import Score
from tools.studies import identified, identify_tacshade, paper, paper_pad
from tools.studies.identify_tacshade import (
    NEAR,
    READINGS,
    TRUE_ME_MM,
    Tried,
    agrees,
    drawn,
    loss,
)
from tools.studies.paper import Judged
from tools.studies.paper_readings import (
    Reading,
    calibrated,
    pressed_object,
    registration_mm,
    scores,
)
from tools.studies.third_family.table_i import SLICE_MM, slices


def found(number: int, me_mm: tuple[float, ...]) -> Tried:
    return Tried(number, drawn(number), READINGS[1], me_mm, loss(me_mm))


def test_table_i_agrees_with_itself_and_neither_a_third_more_nor_another_order_does() -> None:
    assert loss(TRUE_ME_MM) == 0
    assert agrees(TRUE_ME_MM)
    assert not agrees(tuple(1.35 * value for value in TRUE_ME_MM))
    cube, small, ball, large, cylinder = TRUE_ME_MM
    assert not agrees((cylinder, small, ball, large, cube))
    assert loss((math.nan, small, ball, large, cylinder)) == math.inf


def test_a_line_is_read_as_it_was_written() -> None:
    tried = found(4, TRUE_ME_MM)
    assert Tried.parse(tried.line()) == tried
    nothing = Tried(5, drawn(5), None, (), math.inf)
    assert Tried.parse(nothing.line()) == nothing


def test_a_search_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    def tried(number: int, values: dict[str, float | None], readings: object) -> Tried:
        made.append(number)
        return Tried(number, values, READINGS[0], TRUE_ME_MM, 1 / (1 + number))

    monkeypatch.setattr(identify_tacshade, "tried", tried)
    kept = tmp_path / "tried.jsonl"
    list(identify_tacshade.search(kept, random=3, refined=0))
    whole = list(identify_tacshade.search(kept, random=3, refined=2))
    assert made == [0, 1, 2, 3, 4]
    assert [each.number for each in whole] == made
    assert len(kept.read_text().splitlines()) == 5


def test_a_shifted_cloud_is_moved_back() -> None:
    true_mm = np.random.default_rng(1).uniform(0, 5, (2000, 3)).astype(np.float32)
    true_mm[:, 2] = np.sin(true_mm[:, 0]) + np.cos(true_mm[:, 1])
    shift_mm = np.array((0.0, 0.0, 0.3), np.float32)
    assert registration_mm(true_mm[::3] + shift_mm, true_mm) == pytest.approx(-shift_mm, abs=0.05)


@pytest.mark.slow
def test_untouched_skin_joins_a_ball_unless_eq_9_saturates() -> None:
    # The ring that the ball darkens takes eq. 10's zero, so the untouched skin is half as high.
    sensor = SimulatedSensor(random_model(5, 240, 320))
    ball = pressed_object(sensor, "ball", 3.0)
    readings = [Reading(), Reading(saturates=True)]
    me_mm = {
        reading.saturates: only.me_mm
        for reading, (only,) in scores(calibrated(sensor), [ball], readings)
    }
    assert me_mm[False] > 4
    assert me_mm[True] < 1.5


@pytest.mark.slow
def test_the_identified_tacshade_gives_table_i() -> None:
    what, me_mm = next(identified.by_the_paper())
    assert what == "the identified TacShade"
    ratios = np.array(me_mm) / np.array(TRUE_ME_MM)
    assert (ratios < NEAR).all()
    assert (ratios > 1 / NEAR).all()
    assert np.argmin(me_mm) == PAPER_OBJECTS.index("ball")
    assert np.argmax(me_mm) == PAPER_OBJECTS.index("cube")


def test_slices_fill_a_crescent_without_its_rounded_edges() -> None:
    boxes = slices("small_crescent")
    x, y = np.meshgrid(np.arange(-8, 8, 0.05), np.arange(-8, 8, 0.05))
    points = np.stack((x.ravel(), y.ravel(), np.full(x.size, 15.0)), axis=1)
    within = OBJECTS["small_crescent"]().sdf(points) <= -0.2
    filled = np.zeros_like(within)
    for _, (half_x, half_y, _), (middle_x, middle_y, _), _ in boxes:
        filled |= (np.abs(points[:, 0] - middle_x) <= half_x) & (
            np.abs(points[:, 1] - middle_y) <= half_y
        )
    assert {2 * half_y for _, (_, half_y, _), _, _ in boxes} == {SLICE_MM}
    assert np.count_nonzero(filled ^ within) < 0.12 * np.count_nonzero(within)


def test_table_i_is_the_first_row_of_every_family() -> None:
    rows = [
        Judged(method, sensor, name, 3.0, 0.25, 90.0, 80.0)
        for sensor in ("5", "other:5")
        for name in PAPER_OBJECTS
        for method in paper.METHODS
    ]
    rows.append(Judged(paper.METHODS[0], "third:0", "ball", 3.0, 0.25, 90.0, 80.0))
    text = paper.text(rows)
    lines = text.splitlines()
    heads = [k for k, line in enumerate(lines) if line.startswith("Family")]
    assert [lines[k].split(",")[0] for k in heads[::2]] == [
        "Family tacshade",
        "Family other",
        "Family third",
    ]
    for k in heads:
        assert lines[k + 4].startswith("| Table I")
    assert lines[heads[0] + 4].count("0.912") == 1
    assert "90.0 (80.0)" in text


def test_a_line_for_every_map() -> None:
    score = Score(0.2, 0.0, 0.4, 0, 5000.0, 0.99, 0.3, 0.0)
    lines = paper_pad.text([paper_pad.Fused("accurate", "exact", "mean", score)]).splitlines()
    assert [cell.strip() for cell in lines[-1].strip("|").split("|")] == [
        "accurate",
        "exact",
        "mean",
        "0.200",
        "0.400",
        "0.300",
        "99.0",
    ]
