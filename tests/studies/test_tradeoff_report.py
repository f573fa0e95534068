"""Tables, documents, plots, settings and a board's block."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.trade_points import point

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import STAGES
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.studies.evaluate.work import one_thread, stages_ms, work_ns
from tacshade_edge.studies.tradeoff import report
from tacshade_edge.studies.tradeoff.measure import Estimate
from tacshade_edge.studies.tradeoff.report import best_within, over_budget, settings_block
from tacshade_edge.types import Frame
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration

UNKNOWN = Estimate(math.nan, math.nan, math.nan)
SETTINGS = [
    point("fast", 0.2, 1.0, front=True),
    replace(point(replace(PROFILES["fast"], stride_px=8), 0.4, 2.0), p50_ms=Estimate(2.0, math.nan, math.nan)),
    replace(point("accurate", 0.1, 3.0), iou=UNKNOWN),
]


def test_the_csv_has_a_column_for_each_figure_and_nothing_for_nan() -> None:
    lines = list(csv.DictReader(io.StringIO(report.csv_text(SETTINGS))))
    assert [line["setting"] for line in lines] == ["fast", "fast, stride 8 px", "accurate"]
    assert [(line["shipped"], line["front"]) for line in lines] == [("1", "1"), ("0", "0"), ("1", "0")]
    assert (lines[0]["me_mm"], lines[0]["me_mm_low"], lines[1]["p50_ms_low"]) == ("0.2", "0.18", "")
    assert (lines[0]["gate_p99_ms"], lines[0]["depth_p50_ms"]) == ("0.4", "")
    assert {len(line) for line in lines} == {len(report.record(SETTINGS[0]))}


CHOICES = [point("fast", 0.2, 1.0), point("accurate", 0.15, 3.0), point("paper", 2.0, 500.0)]


def chosen(budget_ms: float) -> str | None:
    block = settings_block(CHOICES, budget_ms)
    return block and block.splitlines()[-1]


def test_the_most_accurate_that_keeps_the_budget_in_99_of_100_frames() -> None:
    assert chosen(1.9) is None
    assert chosen(2.0) == "profile: fast"
    assert chosen(5.9) == "profile: fast"
    assert chosen(6.0) == "profile: accurate"
    assert chosen(5000) == "profile: accurate"
    best = best_within(CHOICES, 5000)
    assert best is not None
    assert best.setting.profile.name == "accurate"


def test_a_better_one_that_cannot_be_set_is_told_when_it_is_clearly_better() -> None:
    clearly = point(replace(PROFILES["accurate"], stride_px=8), 0.1, 0.9)
    block = settings_block([*CHOICES, clearly], 2.0)
    assert block is not None
    told, better, setting = block.splitlines()
    assert told.startswith("# The most accurate within 2 ms")
    assert "p99 2.00 ms, p50 1.00 ms, ME 0.200 mm" in told
    assert better.startswith("# Better, but not a shipped profile: accurate, stride 8 px")
    assert setting == "profile: fast"
    hardly = point(replace(PROFILES["accurate"], stride_px=8), 0.19, 0.9)
    assert len((settings_block([*CHOICES, hardly], 2.0) or "").splitlines()) == 2


def test_a_budget_that_none_keeps_is_told_with_the_nearest() -> None:
    assert "the fastest, fast, takes 2.00 ms (p99)" in over_budget(CHOICES, 1.0)
    assert "none can be chosen" in over_budget([], 1.0)


@pytest.mark.slow  # it imports matplotlib
@pytest.mark.parametrize("budget_ms", [None, 3.0])
def test_points_without_intervals_or_figures_are_drawn_or_left_out(budget_ms: float | None) -> None:
    points = [
        point("fast", 0.2, 1.0, front=True),
        replace(point("accurate", 0.1, 3.0, front=True), me_mm=Estimate(0.1, math.nan, math.nan)),
        replace(
            point(replace(PROFILES["paper"], stride_px=8), 2.0, 9.0), p50_ms=Estimate(math.nan, math.nan, math.nan)
        ),
    ]
    image = cv2.imdecode(np.frombuffer(report.draw(points, budget_ms), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.std() > 10


def test_the_stages_that_are_run_in_their_order() -> None:
    made = make_reconstructor(painted_calibration(), PROFILES["fast"])
    touched, free = (stages_ms(made, Frame(0, 0, 0, image)) for image in (TOUCHED, FREE))
    assert tuple(touched) == tuple(stage for stage in STAGES if stage != "denoise")
    assert tuple(free) == ("check", "grey", "gate")
    assert min(*touched.values(), *free.values()) >= 0
    assert sum(touched.values()) > 0
    assert sum(stages_ms(made, Frame(0, 0, 0, TOUCHED), work_ns).values()) > 0


def test_the_threads_are_as_before_also_after_a_failure() -> None:
    before = cv2.getNumThreads()
    during = []

    def fail() -> None:
        with one_thread():
            during.append(cv2.getNumThreads())
            raise ValueError("x")

    with pytest.raises(ValueError, match="x"):
        fail()
    assert during == [1]
    assert cv2.getNumThreads() == before
