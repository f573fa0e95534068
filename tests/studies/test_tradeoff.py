"""The settings of a trade-off, their scores, memory, times and points."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.half_family import HALF_SENSOR, half_family

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import STAGES
from tacshade_edge.studies.evaluate.score import Row
from tacshade_edge.studies.evaluate.work import read_images
from tacshade_edge.studies.parallel import ThisProcess
from tacshade_edge.studies.tradeoff import measure
from tacshade_edge.studies.tradeoff.measure import (
    IDLE_FRAMES,
    WORDS,
    Point,
    SensorCases,
    Setting,
    Times,
    grid,
    make,
    peak_memory,
    points,
    score_settings,
    time_settings,
    weigh_and_time,
)
from tacshade_edge.types import Frame
from tools.testbed.painted_sensor import FREE, TOUCHED, enlarged, enlarged_calibration, painted_calibration


def test_the_whole_grid_has_every_profile_and_no_setting_twice() -> None:
    settings = grid(list(PROFILES))
    assert len(settings) <= 16
    assert len(settings) == len(set(settings)) == len({str(setting) for setting in settings})
    assert [setting.profile.name for setting in settings if setting.shipped] == list(PROFILES)
    assert all(bool(setting.varied) != setting.shipped for setting in settings)
    for dimension in WORDS:
        assert len({setting.fields[dimension] for setting in settings}) > 1


def test_what_differs_is_what_runs() -> None:
    frame, calibration = Frame(0, 0, 0, TOUCHED), painted_calibration()
    paper = PROFILES["paper"]
    settings = (
        Setting(paper),
        Setting(replace(paper, stride_px=4)),
        Setting(paper, scaled_grey=True),
    )
    fine, coarse, grey = (make(setting, calibration).step(frame) for setting in settings)
    assert fine.height.height_mm.size > 10 * coarse.height.height_mm.size
    assert grey.height.height_mm.tobytes() != fine.height.height_mm.tobytes()


pytestmark = pytest.mark.slow  # it calibrates, renders and starts interpreters


def quiet(what: str, done: int, total: int) -> None:
    assert 0 <= done <= total


@pytest.fixture(scope="module")
def sensor() -> Iterator[SensorCases]:
    with half_family():
        (found,) = measure.simulated((HALF_SENSOR,), ("ball", "cube"), ThisProcess(), quiet)
        yield found


def test_all_of_it(sensor: SensorCases, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "SLICE_MS", 5.0)
    settings = grid(("fast",))[:2]
    rows = score_settings(settings, (sensor,), ThisProcess(), quiet)
    points, busy = weigh_and_time(settings, (sensor,), rows, quiet)
    assert [p.setting for p in points] == list(settings)
    assert busy > 0.9
    for point in points:
        assert (point.presses, point.untouched, point.phantoms) == (6, measure.NULL_FRAMES, 0)
        assert 0.02 < point.me_mm.low <= point.me_mm.value <= point.me_mm.high < 1
        assert point.iou.value > 0.5
        assert 0 < point.idle_p50_ms < point.p50_ms.value <= point.p99_ms.value
        assert point.peak_mib > 0
    assert any(p.front for p in points)


def test_the_same_images_give_the_same_rows_and_those_of_a_user_too(sensor: SensorCases, tmp_path: Path) -> None:
    """Written to files as a user has them, read again."""
    settings = grid(("fast",))[:1]
    ((first,),), ((again,),) = (score_settings(settings, (sensor,), ThisProcess(), quiet) for _ in range(2))
    assert first == again
    for k, case in enumerate(sensor.cases[:3]):
        cv2.imwrite(str(tmp_path / f"{k}.png"), case.image)
        truth = case.truth
        np.savez(
            tmp_path / f"{k}.npz", points_mm=truth.points_mm, contact=truth.contact, depth_max_mm=truth.depth_max_mm
        )
    images = sorted(tmp_path.glob("*.png"))
    own = tuple(read_images(sensor.calibration, "mine", images, quiet, lambda text: pytest.fail(text)))
    ((read,),) = score_settings(settings, (SensorCases(sensor.calibration, own),), ThisProcess(), quiet)
    assert [(r.me_mm, r.iou) for r in read] == [(r.me_mm, r.iou) for r in first[:3]]


def test_what_needs_more_weighs_more_and_what_was_there_nothing() -> None:
    paper = PROFILES["paper"]
    settings = [Setting(paper), Setting(replace(paper, stride_px=8))]
    fine, coarse = peak_memory(settings, enlarged_calibration(), [enlarged(TOUCHED)], lambda *_: None)
    assert fine > coarse + 10  # a dozen complex maps of 440 x 440
    assert 0 < coarse < 300


def test_every_setting_is_timed_in_every_round() -> None:
    settings = [Setting(PROFILES["fast"]), Setting(replace(PROFILES["fast"], stride_px=8))]
    threads = cv2.getNumThreads()
    times, busy = time_settings(
        settings, painted_calibration(), [[TOUCHED, TOUCHED], [TOUCHED]], [FREE], quiet, rounds=3
    )
    assert busy > 0.9
    assert cv2.getNumThreads() == threads
    for each, most in zip(times, (2, 1), strict=True):
        assert len(each.contact) == len(each.idle) == 3
        for some in each.contact:
            assert some.shape[1] == 1 + len(STAGES)
            assert 1 <= len(some) <= most
            assert (some[:, 0] > 0).all()
            stages = dict(zip(STAGES, some[:, 1:].T, strict=True))
            for unasked in ("shear", "sigma"):
                assert (stages.pop(unasked) > 0).all()  # not in the step's time: few ask for it
            np.testing.assert_allclose(some[:, 0], np.nansum(list(stages.values()), axis=0))
        assert all(len(some) == IDLE_FRAMES and (some > 0).all() for some in each.idle)


def test_a_setting_that_finds_no_contact_and_no_frames_without_are_nothing() -> None:
    (times,), _ = time_settings([Setting(PROFILES["fast"])], painted_calibration(), [[]], [], quiet, rounds=2)
    assert [some.shape for some in times.contact] == [(0, 1 + len(STAGES))] * 2
    assert [len(some) for some in times.idle] == [0, 0]


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
