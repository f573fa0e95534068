"""Scores and fits at the extremes: eqs. 13 and 14 of one point, far points and huge clouds; factors of odd presses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.examples import examples
from support.networks import ALL_TRUSTED

from tacshade_edge.core.calibration import refit
from tacshade_edge.core.calibration.indenters import Ball
from tacshade_edge.core.depth.learned import Inverse
from tacshade_edge.core.geometry.disc_map import CELLS
from tacshade_edge.studies.evaluate.score import contact_iou, score_cloud
from tacshade_edge.types import F32, Disc, Geometry

clouds = arrays(np.float32, st.tuples(st.integers(1, 20), st.just(3)), elements=st.floats(-1e6, 1e6, width=32))
BALL = Ball(0.0, 0.0, 23.0, 5.0)


@pytest.mark.slow
@given(found=clouds, true=clouds, h_max_mm=st.floats(1e-3, 200))
@examples(200)
def test_any_clouds_have_finite_scores(found: F32, true: F32, h_max_mm: float) -> None:
    score = score_cloud(found, true, h_max_mm)
    assert all(map(math.isfinite, (score.me_mm, score.sd, score.sd_sum, score.backward_mm)))
    assert score.me_mm >= 0
    assert score.sd_sum <= score.sd <= 1
    # float32 points in float64 distances.
    direct = np.linalg.norm(found[:, None].astype(np.float64) - true[None].astype(np.float64), axis=-1)
    assert score.me_mm == pytest.approx(direct.min(axis=1).mean(), rel=1e-9, abs=1e-9)


def test_a_point_is_no_distance_from_itself_however_far_out() -> None:
    for scale in (1e-45, 1.0, 1e18):
        points = (np.eye(3) * scale).astype(np.float32)
        score = score_cloud(points, points, 1.0)
        assert (score.me_mm, score.sd) == (0.0, 1.0)


def test_contacts_of_nothing_and_everything() -> None:
    nothing, everything = np.zeros((4, 5), bool), np.ones((4, 5), bool)
    assert contact_iou(nothing, nothing) == contact_iou(everything, everything) == 1.0
    assert contact_iou(nothing, everything) == 0.0
    assert contact_iou(np.zeros((0, 0), bool), np.zeros((0, 0), bool)) == 1.0


def inverse_of(height_mm: float, bad: float | None = None) -> Inverse:
    height = np.full((CELLS, CELLS), height_mm, np.float32)
    if bad is not None:
        height[50:60, 50:60] = bad
    return Inverse(height, np.full((CELLS, CELLS), 5, np.float32), ALL_TRUSTED)


@pytest.mark.parametrize("distance_mm", [None, 1e-6, 14.0, 1000.0])
@pytest.mark.parametrize("height_mm", [-1.0, 0.0, 1e-6, 1.0, 20.0, 1e6, 1e30])
@pytest.mark.parametrize("bad", [None, math.nan, math.inf, -math.inf])
def test_a_factor_is_in_its_range_whatever_the_network_said(
    distance_mm: float | None, height_mm: float, bad: float | None
) -> None:
    geometry = Geometry(20.0, distance_mm, 50.0, Disc(60.0, 60.0, 50.0))
    rows = refit.press_rows(inverse_of(height_mm, bad), geometry, BALL)
    if rows is None:
        return
    factor = refit.fit_factor([rows] * refit.LEAST_PRESSES)
    assert factor is not None
    assert refit.FACTOR_RANGE[0] <= factor <= refit.FACTOR_RANGE[1]
