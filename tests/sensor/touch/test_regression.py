"""The errors of held-out groups, against a fit without each of them."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from tacshade_edge.sensor.touch import regression
from tacshade_edge.sensor.touch.regression import held_out


@pytest.mark.parametrize("per_group", [1, 4])
def test_a_held_out_group_is_predicted_as_by_a_fit_without_it(per_group: int) -> None:
    random = np.random.default_rng(1)
    rows, functions, ridges = 60, 7, np.array([0.1, 3.0])
    values = random.normal(size=(rows, functions))
    values -= values.mean(axis=0)  # the offset is then independent of the weights
    power, turned = np.linalg.eigh(values.T @ values)
    values = values @ turned
    labels = values @ random.normal(size=functions) + random.normal(size=rows)
    left, groups = labels - labels.mean(), np.arange(rows) // per_group
    inverse = 1 / (power[:, None] + ridges)
    residuals, variances = held_out(values, values**2, inverse, left, values.T @ left, groups)
    ones = np.concatenate((np.ones((rows, 1)), values), axis=1)
    for k, ridge in enumerate(ridges):
        penalty = np.diag([0.0, *[ridge] * functions])
        for group in np.unique(groups):
            held, rest = groups == group, groups != group
            cov = np.linalg.inv(ones[rest].T @ ones[rest] + penalty)
            predicted = ones[held] @ cov @ ones[rest].T @ labels[rest]
            np.testing.assert_allclose(residuals[held, k], labels[held] - predicted, rtol=1e-4)
            variance = np.einsum("ij,jk,ik->i", ones[held], cov, ones[held])
            np.testing.assert_allclose(variances[held, k], variance, rtol=1e-4)


def test_many_ridges_take_no_more_memory_for_a_long_press(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(regression, "HELD_NUMBERS", 100)
    random, rows = np.random.default_rng(2), 50
    values, left = random.normal(size=(2 * rows, 5)), random.normal(size=2 * rows)
    taken = []
    for ridges in (1, 25):
        inverse = 1 / (100 + np.tile(np.arange(ridges), (5, 1)))
        tracemalloc.start()
        held_out(values, values**2, inverse, left, values.T @ left, np.arange(2 * rows) // rows)
        taken.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert taken[1] < 3 * taken[0]
