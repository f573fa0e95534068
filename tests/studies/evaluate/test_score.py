"""Scores against brute force, and the truth on another grid."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tacshade_edge.studies.evaluate.score import KnownTruth, Label, Row, between_pixels, contact_iou, score, score_cloud
from tacshade_edge.studies.evaluate.sensors import reconstructor
from tacshade_edge.types import F32, Bool, Frame, HeightMap, Reconstruction
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration

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
    assert score.me_mm == pytest.approx(forward, abs=1e-6)
    assert score.backward_mm == pytest.approx(backward, abs=1e-6)
    assert score.sd == pytest.approx(1 - (forward + backward) / 2 / h_max, abs=1e-5)
    assert score.sd_sum == pytest.approx(1 - (forward + backward) / h_max, abs=1e-5)


def test_a_perfect_cloud_scores_one_and_a_far_one_below_zero() -> None:
    cloud = np.random.default_rng(1).normal(size=(50, 3)).astype(np.float32)
    perfect = score_cloud(cloud, cloud, 3.0)
    assert (perfect.me_mm, perfect.sd, perfect.sd_sum) == (0.0, 1.0, 1.0)
    assert score_cloud(cloud + np.float32(10), cloud, 3.0).sd < -1


def test_an_empty_cloud_has_failed() -> None:
    score = score_cloud(np.zeros((0, 3), np.float32), np.ones((4, 3), np.float32), 3.0)
    assert math.isnan(score.me_mm)
    assert (score.sd, score.sd_sum) == (0.0, 0.0)


def test_overlap_of_contacts() -> None:
    none, half, full = np.zeros(4, bool), np.array([1, 1, 0, 0], bool), np.ones(4, bool)
    assert contact_iou(none, none) == 1
    assert contact_iou(none, full) == 0
    assert contact_iou(half, full) == contact_iou(full, half) == 0.5


LABEL = Label("painted", "ball")
NOTHING = np.zeros((0, 3), dtype=np.float32)


def found(touched: bool) -> Reconstruction:
    return reconstructor(painted_calibration(), "fast").step(Frame(0, 0, 0, TOUCHED if touched else FREE))


def truth_of(result: Reconstruction) -> KnownTruth:
    """A truth that the result meets exactly."""
    height = result.height
    return KnownTruth(
        result.cloud.points_mm, result.depth_max_mm, height.contact, height.row0, height.col0, height.step_px
    )


def test_a_perfect_result() -> None:
    result = found(touched=True)
    row = score(LABEL, truth_of(result), result)
    assert (row.me_mm, row.sd_pct, row.sd_sum_pct, row.backward_mm, row.iou) == (0, 100, 100, 0, 1)
    assert row.depth_error_pct == pytest.approx(0, abs=1e-4)
    assert row.points == row.true_points > 0


def test_the_scores_are_those_of_the_metrics() -> None:
    result = found(touched=True)
    exact = truth_of(result)
    moved = replace(
        exact, points_mm=exact.points_mm + np.float32(0.7), depth_max_mm=2.0, contact=~result.height.contact
    )
    row, direct = score(LABEL, moved, result), score_cloud(result.cloud.points_mm, moved.points_mm, 2.0)
    assert (row.me_mm, row.sd_pct, row.sd_sum_pct) == (direct.me_mm, 100 * direct.sd, 100 * direct.sd_sum)
    assert row.backward_mm == direct.backward_mm
    assert row.iou == 0
    assert row.depth_error_pct == pytest.approx(100 * (result.depth_max_mm / 2 - 1))


def test_a_missed_contact_and_a_phantom() -> None:
    nothing, something = found(touched=False), found(touched=True)
    missed = score(LABEL, truth_of(something), nothing)
    assert (missed.contact, missed.sd_pct, missed.iou, missed.depth_error_pct) == (False, 0, 0, -100)
    assert math.isnan(missed.me_mm)
    phantom = score(LABEL, KnownTruth(NOTHING, 0.0, None), something)
    assert phantom.contact
    assert phantom.found_depth_mm > 0
    assert all(math.isnan(v) for v in (phantom.me_mm, phantom.sd_pct, phantom.iou, phantom.depth_error_pct))


def on_grid(contact: Bool, row0: float, col0: float, step: float) -> HeightMap:
    return HeightMap(np.zeros(contact.shape, np.float32), contact, row0, col0, step)


def test_a_truth_of_pixels_at_the_cells_of_another_grid() -> None:
    pixels = np.random.default_rng(3).random((60, 80)) < 0.4
    truth = KnownTruth(NOTHING, 0.0, pixels)
    cells = on_grid(np.zeros((15, 20), bool), 2, 2, 4)
    taken = truth.contact_on(cells)
    np.testing.assert_array_equal(taken, pixels[2::4, 2::4])
    # A coarse truth at fine cells, and cells beyond its edge.
    coarse = KnownTruth(NOTHING, 0.0, np.array([[True, False], [False, True]]), 10, 10, 20)
    fine = coarse.contact_on(on_grid(np.zeros((60, 60), bool), 0, 0, 1))
    assert fine is not None
    assert (fine[10, 10], fine[10, 30], fine[30, 30], fine[59, 59], fine[15, 12]) == (True, False, True, False, True)
    assert contact_iou(fine, fine) == 1
    assert KnownTruth(NOTHING, 0.0, None).contact_on(cells) is None


def test_the_truth_has_points_between_its_pixels_but_not_over_a_step() -> None:
    contact = np.zeros((6, 8), bool)
    contact[1:5, 1:7] = True
    rows, cols = np.indices(contact.shape)
    flat = np.stack((cols, rows, np.where(cols < 4, 20.0, 15.0)), axis=-1).astype(np.float32)
    points = between_pixels(flat[contact], contact)
    np.testing.assert_array_equal(points[: contact.sum()], flat[contact])
    made = {tuple(p) for p in points[contact.sum() :]}
    assert {(1.5, 1.0, 20.0), (1.0, 1.5, 20.0), (1.5, 1.5, 20.0), (5.5, 3.0, 15.0)} <= made
    assert {z for _, _, z in made} == {15.0, 20.0}
    alone = np.zeros((3, 3), bool)
    alone[1, 1] = True
    assert len(between_pixels(np.ones((1, 3), np.float32), alone)) == 1
    assert between_pixels(NOTHING, 0 * alone > 0).shape == (0, 3)


def test_every_column_is_set() -> None:
    result = found(touched=True)
    row = score(Label("s", "o", "i", 1.0, 2.0, 3.0, 4.0), truth_of(result), result)
    assert (row.sensor, row.object, row.image, row.depth_mm, row.x_mm, row.y_mm, row.rotation_deg) == (
        "s", "o", "i", 1.0, 2.0, 3.0, 4.0,
    )  # fmt: skip
    assert isinstance(row, Row)
