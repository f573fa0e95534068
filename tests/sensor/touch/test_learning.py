"""Tables whose truth is known: features that are random projections of a few hidden numbers."""

from __future__ import annotations

import numpy as np
import pytest

from tacshade_edge.sensor.touch import regression
from tacshade_edge.sensor.touch.learning import LearntTouch, learn
from tacshade_edge.sensor.touch.touch_answer import predict
from tacshade_edge.types import F32, F64, I64

NAMES = ("depth_mm", "tilt_x_deg")
NOISE = 0.05

pytestmark = pytest.mark.slow  # a model each: seconds of a core


@pytest.fixture(autouse=True)
def few_widths(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each width costs a fit."""
    monkeypatch.setattr(regression, "WIDTHS", (1.0, 2.0))


def table(rows: int, seed: int, noise: float = NOISE) -> tuple[F32, F64]:
    """Features, and the two numbers that they show, each with noise."""
    random = np.random.default_rng(seed)
    mixing = np.random.default_rng(99).normal(size=(6, 300))
    hidden = random.uniform(-1, 1, (rows, 3))
    curved = np.concatenate((hidden, hidden**2), axis=1)
    features = np.maximum(curved @ mixing + 0.05 * random.normal(size=(rows, 300)), -0.5)
    labels = np.stack((hidden[:, 0] + 0.5 * hidden[:, 1] ** 2, np.sin(2 * hidden[:, 2])), axis=1)
    return features.astype(np.float32), labels + noise * random.normal(size=labels.shape)


def learnt(
    features: F32, labels: F64, groups: I64 | None = None, names: tuple[str, ...] = NAMES
) -> LearntTouch:
    imprints = np.zeros((len(features), 7), np.float32)
    rows = np.ones(len(features))
    return learn(
        features,
        imprints,
        rows,
        names,
        labels,
        np.arange(len(features)) if groups is None else groups,
        "n",
    )


@pytest.mark.parametrize("rows", [60, 200])
def test_held_out_frames_are_answered_as_well_as_it_says(rows: int) -> None:
    found = learnt(*table(rows, 1))
    assert found.model is not None
    features, labels = table(400, 2)
    values, sigma, alike = map(
        np.array, zip(*(predict(found.model, row) for row in features), strict=True)
    )
    error = np.abs(values - labels)
    for q, report in enumerate(found.reports):
        assert report.seen
        assert report.error == pytest.approx(error[:, q].mean(), rel=0.3)
        assert 0.8 < np.mean(error[:, q] < 1.645 * sigma[:, q]) < 0.97
        assert 0.8 < report.coverage_90 < 0.97
    assert np.mean(alike) > 0.95


@pytest.mark.parametrize("unit", [1e-12, 1e5])
def test_what_is_found_does_not_depend_on_the_unit(unit: float) -> None:
    features, labels = table(60, 1)
    usual, found = learnt(features, labels), learnt(features, labels * unit)
    for one, other in zip(usual.reports, found.reports, strict=True):
        assert other.r2 == pytest.approx(one.r2, abs=0.02)
        assert other.error == pytest.approx(one.error * unit, rel=0.1)


@pytest.mark.parametrize("unit", [1e-300, 1e-310])
def test_labels_whose_squares_are_nothing_are_not_learnt(unit: float) -> None:
    features, labels = table(60, 1)
    found = learnt(features, labels * unit)
    assert found.model is None
    assert all(np.isfinite([each.r2, each.error]).all() for each in found.reports)


def test_what_the_frames_do_not_show_is_not_answered() -> None:
    features, labels = table(120, 4)
    labels[:, 1] = np.random.default_rng(5).uniform(-5, 5, len(labels))
    found = learnt(features, labels)
    assert [report.seen for report in found.reports] == [True, False]
    assert found.model is not None
    assert found.model.names == ("depth_mm",)
    labels[:, 0] = labels[::-1, 1]
    assert learnt(features, labels).model is None


@pytest.mark.parametrize("constant", [0.0, 2.0, 5e-324])
def test_a_quantity_that_never_changes_is_not_learnt(constant: float) -> None:
    features, labels = table(60, 4)
    labels[:, 1] = constant
    found = learnt(features, labels)
    assert [report.seen for report in found.reports] == [True, False]
    assert found.reports[1].r2 == 0


def test_rows_that_contradict_the_others_are_named() -> None:
    features, labels = table(150, 6)
    labels[[17, 103], 0] += 2.0
    assert learnt(features, labels).reports[0].contradicting == (17, 103)


def test_a_quantity_may_be_labelled_in_some_rows_only() -> None:
    features, labels = table(180, 7)
    labels[::3, 1] = np.nan
    found = learnt(features, labels)
    assert [report.rows for report in found.reports] == [180, 120]
    assert found.model is not None
    fresh, truth = table(200, 8)
    error = np.mean(
        [
            np.abs(predict(found.model, row)[0] - true)
            for row, true in zip(fresh, truth, strict=True)
        ]
    )
    assert error < 3 * NOISE


def test_frames_of_one_press_are_held_out_together() -> None:
    """Each press four times, a little other: by single frames the error would look like the label's
    repetition.
    """
    features, labels = table(40, 9, noise=0.3)
    random = np.random.default_rng(10)
    again = np.repeat(features, 4, axis=0) + random.normal(scale=0.02, size=(160, 300)).astype(
        np.float32
    )
    repeated = np.repeat(labels, 4, axis=0)
    alone = learnt(again, repeated).reports[0].error
    together = learnt(again, repeated, np.repeat(np.arange(40), 4)).reports[0].error
    assert alone < 0.1 < 0.2 < together


def test_a_quantity_of_presses_that_one_fold_holds_out() -> None:
    features, labels = table(150, 16)
    groups = np.arange(150) // 3
    labels[groups % 10 != 0, 1] = np.nan
    report = learnt(features, labels, groups).reports[1]
    assert report.rows == 15
    assert np.isfinite(report.error)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_extremes_stay_finite(scale: float) -> None:
    features, labels = table(80, 14)
    features[:, 0] = 3.0  # one that never changes
    found = learnt((features * scale).astype(np.float32), labels * scale)
    assert found.model is not None
    values, sigma, _ = predict(found.model, features[0] * np.float32(scale))
    assert np.isfinite(values).all()
    assert np.isfinite(sigma).all()
    assert (sigma > 0).all()
    values, _, alike = predict(found.model, np.full(300, 1e9 * scale, np.float32))
    assert np.isfinite(values).all()
    assert not alike
