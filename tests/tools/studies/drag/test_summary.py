import math
from dataclasses import replace

import pytest

from tools.studies.drag.summary import figures, silently_wrong, text
from tools.studies.drag.work import DragRow

ROW = DragRow(
    "fast", "5", "cube", "2 mm", 3.0, 2.0, 30.0, 0.0, 0.0, "", True, False, False, 3.0, 3.1, 0.1, 0.1, 95.0, 0.9,
    2.0, 0.0, 2.1, 0.0, 5.0, 5.5,
)  # fmt: skip


def test_figures_of_rows() -> None:
    missed = replace(
        ROW, contact=False, me_mm=math.nan, sd_pct=0.0, iou=0.0, found_shear_x_mm=math.nan, found_shear_y_mm=math.nan,
        found_twist_deg=math.nan,
    )  # fmt: skip
    turned = replace(ROW, found_shear_x_mm=0.0, found_shear_y_mm=2.0)
    made = figures([ROW, missed, turned])
    assert (made.frames, made.missed, made.refused) == (3, 1, 0)
    assert made.me_mm == pytest.approx((0.1 + 3.0 + 0.1) / 3)
    assert made.sd_pct == pytest.approx(190 / 3)
    assert made.within == 0.5
    assert made.shear_median_mm == pytest.approx((0.1 + math.hypot(2, 2)) / 2)
    assert made.direction_95_deg == pytest.approx(0.95 * 90)
    assert made.twist_95_deg == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({}, False),
        ({"found_depth_mm": 3.76}, True),
        ({"found_depth_mm": 3.74}, False),
        ({"true_depth_mm": 0.4, "found_depth_mm": 0.69}, False),
        ({"true_depth_mm": 0.4, "found_depth_mm": 0.71}, True),
        ({"found_depth_mm": 0.0, "refused": "torn"}, False),
        ({"found_depth_mm": 5.0, "degraded": True}, False),
        ({"found_depth_mm": 2.0, "saturated": True}, False),
        ({"found_depth_mm": 0.0, "contact": False}, True),
    ],
)
def test_what_is_wrong_and_not_told(changes: dict, wrong: bool) -> None:
    assert silently_wrong(replace(ROW, **changes)) is wrong


def test_small_shears_have_no_direction() -> None:
    assert math.isnan(figures([replace(ROW, true_shear_x_mm=0.1)]).direction_95_deg)


def test_a_table_for_each_family() -> None:
    printed = text([ROW, replace(ROW, sensor="other:5", condition="0 mm")])
    assert "Family tacshade" in printed
    assert "Family other" in printed
    assert "| 2 mm |" in printed.replace("  ", " ")
