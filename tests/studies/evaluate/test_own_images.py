import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.studies.evaluate.own_images import evaluate_images, images_in, read_images, read_truth
from tacshade_edge.studies.evaluate.score import Row, contact_iou, score_cloud
from tacshade_edge.studies.evaluate.sensors import reconstructor
from tacshade_edge.types import Bool, Frame, HeightMap
from tools.testbed.painted_sensor import DISC, FREE, HEIGHT, TOUCHED, WIDTH, painted_calibration

CALIBRATION = painted_calibration()
SIZE = (HEIGHT, WIDTH)


def truth(**changes: Any) -> dict[str, Any]:
    """A disc pressed 2 mm deep in the middle; None leaves a key out."""
    rows, cols = np.ogrid[:HEIGHT, :WIDTH]
    off = np.hypot(rows - DISC.row_c, cols - DISC.col_c)
    height = np.where(off <= DISC.radius_px, np.where(off < 20, 2.0, 0.0), np.nan).astype(np.float32)
    made = {"height_mm": height, "contact": off < 20, "object": "coin", **changes}
    return {key: value for key, value in made.items() if value is not None}


def at_cells(known: Bool, height: HeightMap, first_px: float = 0.0, step_px: float = 1.0) -> Bool:
    """What is known nearest to each cell of a height map."""
    cells = height.step_px * np.arange(len(height.contact))
    rows, cols = (np.rint((first + cells - first_px) / step_px).astype(int) for first in (height.row0, height.col0))
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
    cases = read_images(CALIBRATION, "mine", images_in(folder), heard.progress, heard.mistake)
    rows, timings = evaluate_images(CALIBRATION, ("fast",), cases)
    assert not rows or timings["fast"].p50_ms > 0
    return rows, heard.lines


def test_own_images_score_as_the_metrics_do(tmp_path: Path) -> None:
    put(tmp_path, "a", TOUCHED, truth())
    put(tmp_path, "b", FREE, truth(height_mm=np.zeros(SIZE, np.float32), contact=np.zeros(SIZE, bool)))
    (pressed, free), lines = scored(tmp_path)
    assert lines == []
    made = reconstructor(CALIBRATION, "fast")
    result = made.step(Frame(0, 0, 0, TOUCHED))
    known, name = read_truth(tmp_path / "a.npz", SIZE, CALIBRATION.geometry)
    direct = score_cloud(result.cloud.points_mm, known.points_mm, 2.0)
    assert (pressed.me_mm, pressed.sd_pct, pressed.backward_mm) == (direct.me_mm, 100 * direct.sd, direct.backward_mm)
    assert pressed.iou == contact_iou(result.height.contact, at_cells(truth()["contact"], result.height))
    assert (pressed.object, pressed.image, name) == ("coin", "a.png", "coin")
    assert (free.object, free.contact, free.true_points) == ("none", False, 0)


def test_points_come_from_a_height_map_by_eq_2(tmp_path: Path) -> None:
    np.savez(tmp_path / "t.npz", **truth())
    known, _ = read_truth(tmp_path / "t.npz", SIZE, CALIBRATION.geometry)
    assert len(known.points_mm) > 3 * np.count_nonzero(truth()["contact"])  # and between its cells
    np.testing.assert_allclose(np.linalg.norm(known.points_mm, axis=1), 18, atol=0.02)
    assert known.depth_max_mm == 2


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


def test_a_truth_on_a_grid_of_its_own(tmp_path: Path) -> None:
    whole = truth()
    coarse = {key: whole[key][2::4, 2::4] for key in ("height_mm", "contact")}
    np.savez(tmp_path / "t.npz", **coarse, row0=2.0, col0=2.0, step_px=4.0)
    known, _ = read_truth(tmp_path / "t.npz", SIZE, CALIBRATION.geometry)
    grid = reconstructor(CALIBRATION, "fast").step(Frame(0, 0, 0, TOUCHED)).height
    np.testing.assert_array_equal(known.contact_on(grid), at_cells(coarse["contact"], grid, first_px=2, step_px=4))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (truth(contact=None), "found the keys height_mm, object; expected points_mm, or height_mm and contact"),
        ({}, "found the keys none; expected"),
        (
            truth(contact=np.zeros((30, 40), bool)),
            "contact: found 40x30 cells of 1 px, expected cells that cover the image's",
        ),
        (truth(row0=50.0), "expected cells that cover the image's 160x120 px"),
        (truth(height_mm=np.full(SIZE, np.nan)), "height_mm: found NaN inside the contact"),
        (
            truth(points_mm=np.zeros((4, 2))),
            "points_mm: found numbers of shape (4, 2), expected finite numbers of shape (N, 3)",
        ),
        (truth(points_mm=np.full((4, 3), np.nan)), "expected finite numbers of shape (N, 3)"),
        (truth(points_mm=np.array(["a"])), "points_mm: found <U1 values of shape (1,), expected numbers"),
        (truth(height_mm=np.zeros((2, 120, 160))), "height_mm: found float64 values of shape (2, 120, 160)"),
        (truth(step_px=0.0), "step_px: found 0.0, expected a number above 0"),
        (truth(row0=np.array([1.0, 2.0])), "row0: found array([1., 2.]), expected one number"),
        (truth(depth_max_mm=np.nan), "depth_max_mm: found array(nan), expected one number"),
        (truth(depth_max_mm=0.0), "a contact whose greatest depth is 0 mm, expected more than 0 mm"),
        (truth(height_mm=np.zeros(SIZE)), "a contact whose greatest depth is 0 mm"),
    ],
)
def test_a_truth_that_cannot_be_is_one_line(tmp_path: Path, content: dict[str, Any], message: str) -> None:
    np.savez(tmp_path / "t.npz", **content)
    with pytest.raises(DecodeError) as error:
        read_truth(tmp_path / "t.npz", SIZE, CALIBRATION.geometry)
    assert message in str(error.value)
    assert str(tmp_path / "t.npz") in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("damage", ["cut", "text", "empty", "npy", "flipped", "pickle", "absent", "folder", "pipe"])
def test_a_damaged_truth_is_one_line(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "t.npz"
    np.savez(path, **truth())
    whole = path.read_bytes()
    path.unlink()
    if damage == "folder":
        path.mkdir()
    elif damage == "pipe":
        os.mkfifo(path)
    elif damage == "npy":
        with path.open("wb") as stream:
            np.save(stream, np.zeros(3))
    elif damage == "pickle":
        np.savez(path, points_mm=np.array([object()], dtype=object))
    elif damage != "absent":
        flipped = whole[:2000] + bytes(b ^ 0xFF for b in whole[2000:2100]) + whole[2100:]
        path.write_bytes({"cut": whole[:-300], "text": b"no truth", "empty": b"", "flipped": flipped}[damage])
    with pytest.raises(DecodeError, match=r"t\.npz: .*expected") as error:
        read_truth(path, SIZE, CALIBRATION.geometry)
    assert "\n" not in str(error.value)


def test_what_cannot_be_scored_is_told_and_the_others_go_on(tmp_path: Path) -> None:
    put(tmp_path, "a", TOUCHED, truth())
    put(tmp_path, "alone", TOUCHED, None)
    put(tmp_path, "large", cv2.resize(TOUCHED, (320, 240)), truth())
    (tmp_path / "text.png").write_text("no image")
    rows, lines = scored(tmp_path)
    assert [row.image for row in rows] == ["a.png"]
    assert [line.removeprefix(f"{tmp_path}/") for line in lines] == [
        "alone.npz: found no such file, expected the image's ground truth: points_mm, or height_mm and contact",
        "large.png: found 320x240 px, expected 160x120 px, the size of the calibration's images",
        "text.png: found 8 bytes that are not an image, expected a whole image",
    ]


def test_a_folder_without_images_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="found no image"):
        images_in(tmp_path)
    with pytest.raises(ConfigError, match="found no folder"):
        images_in(tmp_path / "nowhere")
