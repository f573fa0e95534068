import math
from dataclasses import replace

import pytest

from tools.studies.limits.rows import DepthRow, DisturbedRow, FineRow
from tools.studies.limits.summary import depth_errors, detected, finest, silently_wrong

PRESS = DepthRow("fast", True, True, False, 1.0, 1, "", "default", True, "ball", 6.0, 1.0, 0.0, 0.0, 1.0)
BARS = FineRow("fast", True, True, False, 2.0, 2, "", 1.9, "bars", 2.0, 0.0, 0.0, 0.0, 0.4, 0.4)
HURT = DisturbedRow("fast", True, True, False, 2.0, 1, "", "default", "glare spot", 0, 0.0, 0.0, 2.0, 2.0)


def test_detected_is_the_part_of_each_depth() -> None:
    rows = [replace(PRESS, depth_mm=d, contact=c) for d, c in ((0.2, False), (0.2, True), (0.1, False))]
    assert detected([*rows, replace(PRESS, radius_mm=3.0)], "fast", 6.0) == [(0.1, 0.0), (0.2, 0.5)]


def test_errors_are_against_the_true_depth() -> None:
    rows = [replace(PRESS, found_mm=f, saturated=s) for f, s in ((0.9, False), (1.3, True))]
    (found,) = depth_errors(rows, "fast", "ball")
    assert found == pytest.approx((1.0, 0.2, 0.28, 0.5))


def test_the_finest_gap_is_the_end_of_an_unbroken_row() -> None:
    def gap(size: float, objects: int) -> FineRow:
        return replace(BARS, size_mm=size, objects=objects)

    assert finest([gap(1, 2), gap(2, 1), gap(3, 2), gap(4, 2)], "fast", 1.9, "gap: two objects") == 3
    assert finest([gap(1, 1)], "fast", 1.9, "gap: two objects") == math.inf
    shallow = [replace(BARS, found_height_mm=h) for h in (0.4, 0.21, 0.3, 0.19)]
    assert finest(shallow, "fast", 1.9, "gap: half the dip") == 2.0
    assert (
        finest([replace(BARS, true_height_mm=0.02, found_height_mm=0.03)], "fast", 1.9, "gap: half the dip") == math.inf
    )
    ridges = [replace(BARS, shape="ridge", size_mm=w, found_height_mm=h) for w, h in ((1, 0.3), (2, 0.45))]
    assert finest(ridges, "fast", 1.9, "ridge: height within 20 %") == 2


def test_wrong_is_what_nobody_was_told() -> None:
    wrong = [replace(HURT, found_mm=2.6), replace(HURT, found_mm=0.0, contact=False)]
    told = [replace(wrong[0], doubt="glare"), replace(wrong[0], saturated=True), replace(wrong[1], valid=False)]
    assert silently_wrong([HURT, replace(HURT, found_mm=2.4), *wrong, *told]) == wrong
