from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tacshade_edge.studies.metrics import contact_iou, score_cloud
from tacshade_edge.types import F32

CLOUDS = hnp.arrays(np.float32, st.tuples(st.integers(1, 30), st.just(3)), elements=st.floats(-30, 30, width=32))


def nearest_mean(a: F32, b: F32) -> float:
    """Brute force: mean over `a` of the distance to the nearest of `b`."""
    apart: npt.NDArray[np.float64] = np.linalg.norm(a[:, None].astype(float) - b[None].astype(float), axis=-1)
    return float(apart.min(axis=1).mean())


@pytest.mark.slow
@given(CLOUDS, CLOUDS, st.floats(0.1, 10))
def test_scores_are_those_of_brute_force(found: F32, true: F32, h_max: float) -> None:
    score = score_cloud(found, true, h_max)
    forward, backward = nearest_mean(found, true), nearest_mean(true, found)
    assert score.me_mm == score.forward_mm == pytest.approx(forward, abs=1e-6)
    assert score.backward_mm == pytest.approx(backward, abs=1e-6)
    assert score.sd == pytest.approx(1 - (forward + backward) / 2 / h_max, abs=1e-5)
    assert score.sd_sum == pytest.approx(1 - (forward + backward) / h_max, abs=1e-5)
    assert (score.points, score.true_points) == (len(found), len(true))


def test_a_perfect_cloud_scores_one_and_a_far_one_below_zero() -> None:
    cloud = np.random.default_rng(1).normal(size=(50, 3)).astype(np.float32)
    perfect = score_cloud(cloud, cloud, 3.0)
    assert (perfect.me_mm, perfect.sd, perfect.sd_sum) == (0.0, 1.0, 1.0)
    assert score_cloud(cloud + np.float32(10), cloud, 3.0).sd < -1


def test_an_empty_cloud_has_failed() -> None:
    score = score_cloud(np.zeros((0, 3), np.float32), np.ones((4, 3), np.float32), 3.0)
    assert math.isnan(score.me_mm)
    assert (score.sd, score.sd_sum, score.points, score.true_points) == (0.0, 0.0, 0, 4)


def test_overlap_of_contacts() -> None:
    none, half, full = np.zeros(4, bool), np.array([1, 1, 0, 0], bool), np.ones(4, bool)
    assert contact_iou(none, none) == 1
    assert contact_iou(none, full) == 0
    assert contact_iou(half, full) == contact_iou(full, half) == 0.5
