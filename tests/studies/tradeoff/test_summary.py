import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import STAGES
from tacshade_edge.studies.evaluate.score import Row
from tacshade_edge.studies.tradeoff.grid import Setting
from tacshade_edge.studies.tradeoff.summary import Point, points
from tacshade_edge.studies.tradeoff.timing import Times

NAN = math.nan
ROUNDS, FRAMES, PRESSES = 12, 10, 30
BASE = PROFILES["fast"]


def row(me_mm: float, *, touched: bool = True, contact: bool = True) -> Row:
    return Row(
        profile="fast", sensor="s", object="ball" if touched else "none", image="", depth_mm=3, x_mm=0, y_mm=0,
        rotation_deg=0, valid=True, contact=contact, saturated=False, true_depth_mm=3.0 if touched else 0.0,
        found_depth_mm=2.7, depth_error_pct=-10.0 if touched else NAN, me_mm=me_mm, sd_pct=90.0, sd_sum_pct=80.0,
        backward_mm=0.3, iou=0.8 if touched else NAN, points=5, true_points=9 if touched else 0, objects=1,
        repaired_px=0, degraded="",
    )  # fmt: skip


def times(median_ms: float, seed: int, noise: float = 0.1) -> Times:
    """Rounds that are busy together, and noise of their own."""
    common = np.random.default_rng(99).uniform(1, 1.5, ROUNDS)
    rng = np.random.default_rng(seed)
    rounds = []
    for k in range(ROUNDS):
        total = median_ms * common[k] * (1 + noise * rng.uniform(-1, 1, FRAMES))
        stages = np.full((FRAMES, len(STAGES)), NAN)
        stages[:, 0] = total
        rounds.append(np.column_stack((total, stages)))
    return Times(tuple(rounds), tuple(np.full(5, 0.3) for _ in range(ROUNDS)))


def summarised(errors: Sequence[Sequence[float]], medians: Sequence[float], noise: float = 0.1) -> tuple[Point, ...]:
    settings = [Setting(replace(BASE, stride_px=k + 1)) for k in range(len(errors))]
    rows = [[*(row(me) for me in some), row(NAN, touched=False, contact=False)] for some in errors]
    taken = [times(ms, k, noise) for k, ms in enumerate(medians)]
    return points(settings, rows, taken, [1.0] * len(errors))


def errors(mean: float, seed: int) -> list[float]:
    return list(np.random.default_rng(seed).normal(mean, 0.05, PRESSES))


def test_figures_and_their_intervals() -> None:
    (point,) = summarised([errors(0.5, 1)], [2.0])
    assert point.me_mm.value == pytest.approx(np.mean(errors(0.5, 1)))
    # The standard error of 30 with a deviation of 0.05 is 0.009.
    assert point.me_mm.low < point.me_mm.value < point.me_mm.high
    assert 0.02 < point.me_mm.high - point.me_mm.low < 0.06
    assert 2.0 < point.p50_ms.low <= point.p50_ms.value <= point.p50_ms.high < 3.0
    assert point.p99_ms.value > point.p50_ms.value
    assert 1000 / 3.3 < point.fps < 1000 / 2.0
    assert (point.presses, point.missed, point.untouched, point.phantoms) == (PRESSES, 0, 1, 0)
    assert (point.timed, point.idle_p50_ms, point.depth_off_pct.value) == (ROUNDS * FRAMES, 0.3, 10.0)
    assert [name for name, _, _ in point.stages_ms] == [STAGES[0]]


def test_a_missed_contact_is_as_wrong_as_it_is_deep() -> None:
    (point,) = summarised([[NAN, 1.0, 1.0]], [1.0])
    assert (point.missed, point.me_mm.value) == (1, pytest.approx(5 / 3))


def test_noise_does_not_order_the_results() -> None:
    """The same answers at the same speed: neither beats the other, whatever the medians say."""
    same = errors(0.5, 1)
    found = summarised([same, same, same], [2.0, 2.0, 2.0])
    assert len({p.p50_ms.value for p in found}) == 3
    assert [p.front for p in found] == [True] * 3


def test_rounds_that_were_busy_together_do_not_hide_a_difference() -> None:
    """Each interval is as wide as the rounds differ, a half; the settings differ by 3 % in each of them."""
    same = errors(0.5, 1)
    found = summarised([same, same], [2.0, 2.06], noise=0.005)
    assert found[0].p50_ms.high > found[1].p50_ms.low
    assert [p.front for p in found] == [True, False]


def test_the_front_is_what_no_other_beats_in_both() -> None:
    means, medians = (0.5, 0.3, 0.55, 0.2), (1.0, 2.0, 1.5, 4.0)
    found = summarised([errors(mean, k) for k, mean in enumerate(means)], medians)
    assert [p.front for p in found] == [True, True, False, True]


def test_a_setting_that_finds_nothing_is_on_no_front() -> None:
    nothing = Times(tuple(np.empty((0, 1 + len(STAGES))) for _ in range(ROUNDS)), (np.empty(0),) * ROUNDS)
    settings = [Setting(BASE), Setting(replace(BASE, stride_px=8))]
    rows = [[row(0.2)] * 4, [row(NAN, contact=False)] * 4]
    found = points(settings, rows, [times(1.0, 0), nothing], [1.0, 1.0])
    assert [p.front for p in found] == [True, False]
    assert (found[1].missed, found[1].timed) == (4, 0)
    assert math.isnan(found[1].p99_ms.value)
    assert math.isnan(found[1].fps)


def test_with_two_presses_there_is_no_interval() -> None:
    (point,) = summarised([[0.2, 0.4]], [1.0])
    assert point.me_mm.value == pytest.approx(0.3)
    assert math.isnan(point.me_mm.low)
    assert point.front


def test_where_no_outline_is_known_there_is_no_overlap() -> None:
    rows = [[replace(row(0.2), iou=NAN)] * 4]
    (point,) = points([Setting(BASE)], rows, [times(1.0, 0)], [1.0])
    assert math.isnan(point.iou.value)
