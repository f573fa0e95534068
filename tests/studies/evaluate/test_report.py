"""Figures over rows, and the tables and documents of them."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import fields, replace

import pytest
from support.evaluation_rows import ROW

from tacshade_edge.simulator.objects import PAPER_OBJECTS
from tacshade_edge.studies.evaluate.report import (
    TABLE_I,
    beats_table_i,
    by_object,
    document,
    figures,
    null_figures,
    table,
    worst,
)
from tacshade_edge.studies.evaluate.score import Row
from tacshade_edge.studies.evaluate.work import Timing
from tacshade_edge.studies.tables import csv_text


def test_means_and_the_worst() -> None:
    rows = [replace(ROW, me_mm=0.1, depth_error_pct=-30.0), replace(ROW, me_mm=0.3, depth_error_pct=10.0)]
    found = figures(rows)
    assert (found.presses, found.missed) == (2, 0)
    assert found.me_mm == pytest.approx(0.2)
    assert (found.depth_error_pct, found.depth_error_worst_pct) == (20, 30)


def test_a_missed_contact_counts_as_a_skin_left_alone() -> None:
    missed = replace(ROW, me_mm=math.nan, backward_mm=math.nan, sd_pct=0.0, iou=0.0, contact=False, true_depth_mm=3.0)
    found = figures([replace(ROW, me_mm=0.2, backward_mm=0.4, sd_pct=90.0), missed])
    assert found.missed == 1
    assert (found.me_mm, found.backward_mm, found.sd_pct) == pytest.approx((1.6, 1.7, 45))


def test_nothing_known_is_nan_and_not_a_good_score() -> None:
    assert math.isnan(figures([]).me_mm)
    assert math.isnan(figures([replace(ROW, iou=math.nan)]).iou)


def test_the_worst_object_is_the_largest_mean_over_one_objects_presses() -> None:
    rows = [
        replace(ROW, object="cube", me_mm=0.1, sd_pct=99.0, iou=0.9),
        replace(ROW, object="cube", me_mm=0.9, sd_pct=91.0, iou=0.9),
        replace(ROW, object="ball", me_mm=0.6, sd_pct=94.0, iou=0.5),
    ]
    objects = by_object(rows)
    assert list(objects) == ["cube", "ball"]
    found = worst(list(objects.values()))
    assert (found.me_mm, found.sd_pct, found.iou) == pytest.approx((0.6, 94, 0.5))


def test_frames_without_contact() -> None:
    null = replace(ROW, object="none", true_points=0, contact=False, found_depth_mm=0.0)
    rows = [ROW, null, replace(null, contact=True, found_depth_mm=0.4), replace(null, valid=False)]
    found = null_figures(rows)
    assert (found.frames, found.phantoms, found.deepest_mm, found.refused) == (3, 1, 0.4, 1)
    assert figures(rows).presses == 1


def test_table_i_is_beaten_in_both_measures_or_not() -> None:
    assert len(TABLE_I) == 5
    rows = [
        replace(ROW, object="cube", me_mm=0.5, sd_pct=90.0),
        replace(ROW, object="ball", me_mm=0.05, sd_pct=90.0),
        replace(ROW, object="ring", me_mm=0.01, sd_pct=99.0),
    ]
    assert beats_table_i(by_object(rows)) == (1, 2)


NULL = replace(
    ROW, object="none", contact=False, true_points=0, me_mm=math.nan, sd_pct=math.nan, iou=math.nan, found_depth_mm=0.0
)
ROWS = [
    *(replace(ROW, object=name, me_mm=0.1 * (k + 1)) for k, name in enumerate((*PAPER_OBJECTS, "ring"))),
    NULL,
]
TIMINGS = {"fast": Timing(7.25, 15)}


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_table_i_stands_beside_every_profile() -> None:
    text = table(ROWS, TIMINGS)
    lines = [cells(line) for line in text.splitlines() if line.startswith("|")]
    first = text[: text.index("Other objects")].splitlines()[2:-1]
    assert [cells(line)[:3] for line in first[2:6]] == [
        ["cube", "Table I (real sensor)", "0.912"],
        ["cube", "fast", "0.100"],
        ["small_crescent", "Table I (real sensor)", "0.501"],
        ["small_crescent", "fast", "0.200"],
    ]
    assert len({len(line) for line in first}) == 1  # a terminal shows columns
    assert next(x for x in lines if x[0] == "mean")[:5] == ["mean", "Table I (real sensor)", "0.639", "", "82.1"]
    assert ["worst object", "fast", "0.500"] in [x[:3] for x in lines]
    assert ["ring", "fast", "0.600"] in [x[:3] for x in lines]
    assert lines[-1] == ["fast", "4 of 5", "1", "0", "0.00", "0", "7.2"]


def test_part_of_table_i_has_a_mean_of_that_part() -> None:
    text = table([ROWS[0], ROWS[2]], {})
    mean = next(line for line in text.splitlines() if line.startswith("| mean"))
    assert cells(mean)[2] == "0.508"
    assert "Other objects" not in text


def test_families_are_not_mixed() -> None:
    other = [replace(row, sensor=f"other:{row.sensor}", me_mm=2 * row.me_mm) for row in ROWS]
    text = table([*ROWS, *other], TIMINGS)
    first, second = text.split("Family other")
    assert first.startswith("Family tacshade")
    assert first.removeprefix("Family tacshade").strip() == table(ROWS, TIMINGS)
    assert second.strip() == table(other, TIMINGS)


def test_frames_without_contact_alone_make_a_table() -> None:
    assert cells(table([NULL], {}).splitlines()[-1]) == ["fast", "", "1", "0", "0.00", "0", ""]


def test_a_line_and_a_column_for_everything() -> None:
    lines = list(csv.DictReader(io.StringIO(csv_text(Row, [ROW, NULL]))))
    assert list(lines[0]) == [field.name for field in fields(Row)]
    assert (lines[0]["me_mm"], lines[0]["valid"], lines[0]["points"]) == ("0.2", "1", "100")
    assert (lines[1]["object"], lines[1]["me_mm"], lines[1]["contact"]) == ("none", "", "0")


def test_the_document_is_json_that_any_program_reads() -> None:
    nowhere = replace(ROW, object="ring", iou=math.nan)
    made = document([ROWS[0], nowhere, NULL], TIMINGS, {"presses": 40})
    text = json.dumps(made, allow_nan=False)
    read = json.loads(text)
    fast = read["profiles"]["fast"]
    assert fast["objects"]["ring"]["iou"] is None
    assert fast["paper_objects"]["mean"]["me_mm"] == fast["objects"]["cube"]["me_mm"] == 0.1
    assert fast["other_objects"]["worst"]["me_mm"] == 0.2
    assert fast["without_contact"]["frames"] == 1
    assert fast["timing"] == {"p50_ms": 7.25, "steps": 15}
    assert read["settings"] == {"presses": 40}
    assert {"python", "numpy", "tacshade-edge"} <= set(read["versions"])
    assert read["table_i"]["ball"] == {"me_mm": 0.1039, "sd_pct": 96.02}
