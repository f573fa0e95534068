import math
from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.studies.evaluate.score import KnownTruth, Label, Row, between_pixels, score
from tacshade_edge.studies.evaluate.sensors import reconstructor
from tacshade_edge.studies.metrics import contact_iou, score_cloud
from tacshade_edge.types import Bool, Frame, HeightMap, Reconstruction
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration

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
