"""Scores against brute force, and of a user's own images."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from support.painted_sensor import DISC, FREE, HEIGHT, TOUCHED, WIDTH, painted_calibration
from tacshade_edge.cli import main
from tacshade_edge.errors import DecodeError
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.studies.evaluate.score import (
    KnownTruth,
    Label,
    Row,
    between_pixels,
    contact_iou,
    read_truth,
    score,
    score_cloud,
)
from tacshade_edge.lab.studies.evaluate.work import read_images, reconstructor, score_cases
from tacshade_edge.types import F32, Bool, Frame, Geometry, HeightMap, Reconstruction

CLOUDS = hnp.arrays(
    np.float32, st.tuples(st.integers(1, 30), st.just(3)), elements=st.floats(-30, 30, width=32)
)


def nearest_mean(a: F32, b: F32) -> float:
    """Brute force: mean over `a` of the distance to the nearest of `b`."""
    apart: npt.NDArray[np.float64] = np.linalg.norm(
        a[:, None].astype(float) - b[None].astype(float), axis=-1
    )
    return float(apart.min(axis=1).mean())


@given(CLOUDS, CLOUDS, st.floats(0.1, 10))
def test_scores_are_those_of_brute_force(found: F32, true: F32, h_max: float) -> None:
    score = score_cloud(found, true, h_max)
    forward, backward = nearest_mean(found, true), nearest_mean(true, found)
    assert score.me_mm == pytest.approx(forward, abs=1e-6)
    assert score.backward_mm == pytest.approx(backward, abs=1e-6)
    assert score.sd == pytest.approx(1 - (forward + backward) / 2 / h_max, abs=1e-5)
    assert score.sd_sum == pytest.approx(1 - (forward + backward) / h_max, abs=1e-5)


def test_an_empty_cloud_has_failed() -> None:
    score = score_cloud(np.zeros((0, 3), np.float32), np.ones((4, 3), np.float32), 3.0)
    assert math.isnan(score.me_mm)
    assert (score.sd, score.sd_sum) == (0.0, 0.0)


LABEL = Label("painted", "ball")
NOTHING = np.zeros((0, 3), dtype=np.float32)


def found(touched: bool) -> Reconstruction:
    return reconstructor(painted_calibration(), "fast").step(
        Frame(0, 0, 0, TOUCHED if touched else FREE)
    )


def truth_of(result: Reconstruction) -> KnownTruth:
    """A truth that the result meets exactly."""
    height = result.height
    return KnownTruth(
        result.cloud.points_mm,
        result.depth_max_mm,
        height.contact,
        height.row0,
        height.col0,
        height.step_px,
    )


def test_a_perfect_result() -> None:
    result = found(touched=True)
    row = score(LABEL, truth_of(result), result)
    assert (row.me_mm, row.sd_pct, row.sd_sum_pct, row.backward_mm, row.iou) == (0, 100, 100, 0, 1)
    assert row.depth_error_pct == pytest.approx(0, abs=1e-4)
    assert row.points == row.true_points > 0


def test_a_missed_contact_and_a_phantom() -> None:
    nothing, something = found(touched=False), found(touched=True)
    missed = score(LABEL, truth_of(something), nothing)
    assert (missed.contact, missed.sd_pct, missed.iou, missed.depth_error_pct) == (
        False,
        0,
        0,
        -100,
    )
    assert math.isnan(missed.me_mm)
    for known in (NOTHING, truth_of(something).points_mm):  # nothing touches, or without any depth
        phantom = score(LABEL, KnownTruth(known, 0.0, None), something)
        assert phantom.contact
        assert phantom.found_depth_mm > 0
        assert all(
            math.isnan(v)
            for v in (phantom.me_mm, phantom.sd_pct, phantom.iou, phantom.depth_error_pct)
        )


def test_a_touch_of_unknown_depth_is_found_but_has_no_depth() -> None:
    something = truth_of(found(touched=True))
    unknown = replace(found(touched=False), touched=True)
    row = score(LABEL, something, unknown)
    assert (row.contact, row.touched, row.sd_pct, row.iou) == (False, True, 0, 0)
    assert all(math.isnan(v) for v in (row.me_mm, row.found_depth_mm, row.depth_error_pct))
    free = score(LABEL, KnownTruth(NOTHING, 0.0, None), unknown)
    assert (free.contact, free.touched) == (False, True)
    assert math.isnan(free.found_depth_mm)


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
    assert (fine[10, 10], fine[10, 30], fine[30, 30], fine[59, 59], fine[15, 12]) == (
        True,
        False,
        True,
        False,
        True,
    )
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


CALIBRATION = painted_calibration()
SIZE = (HEIGHT, WIDTH)


def truth(**changes: Any) -> dict[str, Any]:
    """A disc pressed 2 mm deep in the middle; None leaves a key out."""
    rows, cols = np.ogrid[:HEIGHT, :WIDTH]
    off = np.hypot(rows - DISC.row_c, cols - DISC.col_c)
    height = np.where(off <= DISC.radius_px, np.where(off < 20, 2.0, 0.0), np.nan).astype(
        np.float32
    )
    made = {"height_mm": height, "contact": off < 20, "object": "coin", **changes}
    return {key: value for key, value in made.items() if value is not None}


def at_cells(known: Bool, height: HeightMap, first_px: float = 0.0, step_px: float = 1.0) -> Bool:
    """What is known nearest to each cell of a height map."""
    cells = height.step_px * np.arange(len(height.contact))
    rows, cols = (
        np.rint((first + cells - first_px) / step_px).astype(int)
        for first in (height.row0, height.col0)
    )
    return np.asarray(known[np.ix_(rows, cols)])


def put(folder: Path, stem: str, image: Any, content: dict[str, Any] | None) -> Path:
    path = folder / f"{stem}.png"
    cv2.imwrite(str(path), image)
    if content is not None:
        np.savez(folder / f"{stem}.npz", **content)
    return path


@dataclass
class Heard:
    lines: list[str]

    def progress(self, what: str, done: int, total: int) -> None:
        assert 0 <= done <= total

    def mistake(self, text: str) -> None:
        self.lines.append(text)


def scored(folder: Path) -> tuple[list[Row], list[str]]:
    heard = Heard([])
    cases = read_images(
        CALIBRATION, "mine", sorted(folder.glob("*.png")), heard.progress, heard.mistake
    )
    return score_cases(CALIBRATION, ("fast",), cases), heard.lines


def test_own_images_score_as_the_metrics_do(tmp_path: Path) -> None:
    put(tmp_path, "a", TOUCHED, truth())
    put(
        tmp_path,
        "b",
        FREE,
        truth(height_mm=np.zeros(SIZE, np.float32), contact=np.zeros(SIZE, bool)),
    )
    (pressed, free), lines = scored(tmp_path)
    assert lines == []
    made = reconstructor(CALIBRATION, "fast")
    result = made.step(Frame(0, 0, 0, TOUCHED))
    known, name = read_truth(tmp_path / "a.npz", SIZE, CALIBRATION.geometry)
    direct = score_cloud(result.cloud.points_mm, known.points_mm, 2.0)
    assert (pressed.me_mm, pressed.sd_pct, pressed.backward_mm) == (
        direct.me_mm,
        100 * direct.sd,
        direct.backward_mm,
    )
    assert pressed.iou == contact_iou(
        result.height.contact, at_cells(truth()["contact"], result.height)
    )
    assert (pressed.object, pressed.image, name) == ("coin", "a.png", "coin")
    assert (free.object, free.contact, free.true_points) == ("none", False, 0)


def test_points_alone_are_enough(tmp_path: Path) -> None:
    points = np.array([[0, 0, 17.5], [1, 0, 18]], np.float64)
    np.savez(tmp_path / "t.npz", points_mm=points)
    known, name = read_truth(tmp_path / "t.npz", SIZE, CALIBRATION.geometry)
    np.testing.assert_array_equal(known.points_mm, points)
    assert (known.depth_max_mm, known.contact, name) == (2.5, None, "t")
    put(tmp_path, "t", TOUCHED, {"points_mm": points})
    (row,), lines = scored(tmp_path)
    assert lines == []
    assert np.isnan(row.iou)
    assert row.me_mm > 0


PAD = Geometry(math.inf, 40.0, 0.0, DISC, 12.0)
"""A pad whose lens is 40 mm behind it."""


@pytest.mark.parametrize("keys", [("points_mm",), ("height_mm", "contact")])
def test_a_truth_of_a_pad_is_below_its_plane(tmp_path: Path, keys: tuple[str, ...]) -> None:
    known = truth(points_mm=np.array([[0, 0, -2.0], [1, 0, -1.5]]))
    np.savez(tmp_path / "t.npz", **{key: known[key] for key in keys})
    made, _ = read_truth(tmp_path / "t.npz", SIZE, PAD)
    assert made.depth_max_mm == 2.0
    assert made.points_mm[:, 2].min() == -2.0
    # The plate's edge is 20 px from the middle of a circle of 12 mm, seen from 38 mm instead of 40.
    if "contact" in keys:
        reach_mm = np.hypot(*made.points_mm[:, :2].T).max()
        assert reach_mm == pytest.approx(20 / DISC.radius_px * 12 * 38 / 40, abs=0.2)


@pytest.mark.parametrize("keys", [("points_mm",), ("points_mm", "height_mm", "contact")])
def test_a_truth_of_another_form_of_skin_is_refused(tmp_path: Path, keys: tuple[str, ...]) -> None:
    dome, pad = np.array([[0, 0, 18.0], [1, 0, 18.5]]), np.array([[0, 0, -2.0], [1, 0, -1.5]])
    for points, geometry in ((dome, PAD), (pad, CALIBRATION.geometry)):
        known = truth(points_mm=points)
        np.savez(tmp_path / "t.npz", **{key: known[key] for key in keys})
        with pytest.raises(DecodeError, match="found a contact whose greatest depth is"):
            read_truth(tmp_path / "t.npz", SIZE, geometry)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            truth(contact=None),
            "found the keys height_mm, object; expected points_mm, or height_mm and contact",
        ),
        (
            truth(contact=np.zeros((30, 40), bool)),
            "contact: found 40x30 cells of 1 px, expected cells that cover the image's",
        ),
        (truth(height_mm=np.full(SIZE, np.nan)), "height_mm: found NaN inside the contact"),
        (
            truth(points_mm=np.zeros((4, 2))),
            "points_mm: found numbers of shape (4, 2), expected the shape (N, 3)",
        ),
        (
            truth(points_mm=np.full((4, 3), 1e300)),
            "points_mm: found 1e+300, expected numbers from -1e+06",
        ),
        (truth(points_mm=np.full((4, 3), 0.01)), "greatest depth is 20 mm"),  # in m
        (
            truth(height_mm=np.full(SIZE, 0.003)),
            "greatest depth is 0.003 mm, expected a depth from 0.02 to 16 mm",
        ),
        (truth(height_mm=np.full(SIZE, 2**64 - 1, np.uint64)), "height_mm: found 1.84467e+19"),
        (
            truth(height_mm=np.zeros((31, 40)), contact=np.zeros((30, 40)), step_px=4.0),
            "or other cells",
        ),
        ({"x" * 400: 1}, "…'; expected points_mm"),
        (truth(shear_mm=np.zeros((*SIZE, 3))), "shear_mm: found numbers of shape (120, 160, 3)"),
        (
            truth(points_mm=np.array(["a"])),
            "points_mm: found <U1 values of shape (1,), expected numbers",
        ),
        (
            truth(height_mm=np.zeros((2, 120, 160))),
            "height_mm: found float64 values of shape (2, 120, 160)",
        ),
        (truth(step_px=0.0), "step_px: found 0.0, expected a number above 0"),
        (
            truth(row0=np.array([1.0, 2.0])),
            "row0: found float64 values of shape (2,), expected numbers in 0 dimensions",
        ),
        (truth(depth_max_mm=np.nan), "depth_max_mm: found NaN"),
        (truth(height_mm=np.zeros(SIZE)), "a contact whose greatest depth is 0 mm"),
    ],
)
def test_a_truth_that_cannot_be_is_one_line(
    tmp_path: Path, content: dict[str, Any], message: str
) -> None:
    np.savez(tmp_path / "t.npz", **content)
    with pytest.raises(DecodeError) as error:
        read_truth(tmp_path / "t.npz", SIZE, CALIBRATION.geometry)
    assert message in str(error.value)
    assert str(tmp_path / "t.npz") in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_what_simulate_writes_is_a_truth(tmp_path: Path) -> None:
    assert main(["simulate", "--out", str(tmp_path), "--objects", "ball"]) == 0
    known, name = read_truth(tmp_path / "000_ball.npz", (480, 640), SensorModel().geometry)
    assert (len(known.points_mm) > 1000, name) == (True, "ball")


def test_what_cannot_be_scored_is_reported_and_the_others_go_on(tmp_path: Path) -> None:
    put(tmp_path, "a", TOUCHED, truth())
    put(tmp_path, "alone", TOUCHED, None)
    put(tmp_path, "large", cv2.resize(TOUCHED, (320, 240)), truth())
    (tmp_path / "text.png").write_text("no image")
    rows, lines = scored(tmp_path)
    assert [row.image for row in rows] == ["a.png"]
    assert [line.removeprefix(f"{tmp_path}/") for line in lines] == [
        (
            "alone.npz: found no such file, expected the image's ground truth: points_mm, or "
            "height_mm and contact"
        ),
        "large.png: found 320x240 px, expected 160x120 px, the size of the calibration's images",
        "text.png: found text that begins with 'no image', expected a whole image",
    ]
