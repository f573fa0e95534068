import math
from dataclasses import replace

import pytest
from support.evaluation_rows import ROW

from tacshade_edge.studies.evaluate.summary import TABLE_I, beats_table_i, by_object, figures, null_figures, worst


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
