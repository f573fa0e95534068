from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.csv_rows import csv_rows
from support.half_family import half_family
from support.painted_sensor import BLACK, HEIGHT, TOUCHED, WIDTH, painted_calibration
from support.progress_lines import only_progress, without_progress
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import main
from tacshade_edge.lab.studies.evaluate.score import Row
from tacshade_edge.types import Geometry

WRITTEN = ["evaluation.csv", "evaluation.json", "evaluation.md"]
SMALL = [
    "evaluate",
    "--objects",
    "ball",
    "--presses",
    "0",
    "--references",
    "1",
    "--profile",
    "fast",
]


@pytest.fixture
def half() -> Iterator[None]:
    with half_family():
        yield


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A calibration and one image with its truth."""
    calibration_file.save(tmp_path / "cal.npz", painted_calibration())
    (tmp_path / "images").mkdir()
    cv2.imwrite(str(tmp_path / "images" / "coin.png"), TOUCHED)
    rows, cols = np.ogrid[:HEIGHT, :WIDTH]
    contact = np.hypot(rows - 59.5, cols - 79.5) < 20
    np.savez(
        tmp_path / "images" / "coin.npz", height_mm=np.where(contact, 2.0, 0.0), contact=contact
    )
    return tmp_path


def of_own(folder: Path, *more: str) -> list[str]:
    return [
        "evaluate",
        "--calibration",
        str(folder / "cal.npz"),
        "--images",
        str(folder / "images"),
        *more,
    ]


@pytest.mark.slow
@pytest.mark.usefixtures("half")
def test_the_files_the_table_and_the_same_bytes_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = tmp_path / "out", tmp_path / "again"
    words = [*SMALL, "--sensors", "half:default", "--out"]
    assert main([*words, str(first)]) == 0
    printed = capsys.readouterr()
    assert only_progress(printed.err)
    assert "Table I (real sensor)" in printed.out
    assert sorted(p.name for p in first.iterdir()) == WRITTEN
    rows = csv_rows(first / "evaluation.csv")
    assert list(rows[0]) == [field.name for field in fields(Row)]
    assert [row["object"] for row in rows] == ["ball"] * 9 + ["none"] * 20
    summary = json.loads((first / "evaluation.json").read_text())
    assert summary["settings"]["sensors"][0]["model"]["image_width_px"] == 320
    assert main([*words, str(second), "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out) == json.loads((second / "evaluation.json").read_text())
    assert (first / "evaluation.csv").read_bytes() == (second / "evaluation.csv").read_bytes()


def test_own_images(own: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(of_own(own, "--profile", "fast", "--out", str(own / "out"))) == 0
    printed = capsys.readouterr()
    assert only_progress(printed.err)
    assert "coin" in printed.out
    (row,) = csv_rows(own / "out" / "evaluation.csv")
    assert (row["sensor"], row["image"], row["object"], row["contact"]) == (
        "cal.npz",
        "coin.png",
        "coin",
        "1",
    )
    summary = json.loads((own / "out" / "evaluation.json").read_text())
    assert summary["settings"]["crc32"] == f"{calibration_file.load(own / 'cal.npz').crc32:08x}"
    assert sorted(p.name for p in (own / "out").iterdir()) == WRITTEN


@pytest.fixture
def pad(own: Path) -> Path:
    """The same with the calibration of a pad."""
    painted = painted_calibration()
    flat = Geometry(math.inf, 40.0, 0.0, painted.geometry.disc, 16.0)
    calibration_file.save(own / "cal.npz", replace(painted, geometry=flat))
    return own


def test_own_images_of_a_pad(pad: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(of_own(pad, "--profile", "fast", "--json")) == 0
    found = json.loads(capsys.readouterr().out)["profiles"]["fast"]["all"]
    assert (found["found"], found["touched"], found["missed"]) == (1, 0, 0)
    assert 0 < found["me_mm"] < 2.0


def test_labelled_images_of_a_pad(pad: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (pad / "LABELS.csv").write_text("image,depth_mm\ncoin.png,2\n")
    assert (
        main(of_own(pad, "--labels", str(pad / "LABELS.csv"), "--profile", "fast", "--json")) == 0
    )
    (row,) = json.loads(capsys.readouterr().out)["frames"]
    assert row["contact"]
    assert row["depth_mm"] > 0


def test_a_label_that_nothing_scores_is_said_to_be_so(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (own / "LABELS.csv").write_text("image,depth_mm,twist_deg,force_z_n\ncoin.png,2,0,-3\n")
    given = of_own(own, "--labels", str(own / "LABELS.csv"), "--profile", "balanced", "--json")
    assert main(given) == 0
    printed = capsys.readouterr()
    (touch,) = json.loads(printed.out)["touch"]["balanced"]
    assert (touch["quantity"], touch["frames"]) == ("twist_deg", 1)
    assert without_progress(printed.err) == [
        "tacshade-edge: force_z_n: not scored: the calibration's balanced has not learnt it; "
        "`calibrate --labels` learns it from frames"
    ]


def test_labels_that_cannot_teach_are_said_to_be_so(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = own / "LABELS.csv"
    table.write_text("image,tilt_x_deg\n" + 12 * "coin.png,2\n")
    assert main(of_own(own, "--labels", str(table), "--profile", "fast", "--json")) == 0
    assert without_progress(capsys.readouterr().err) == [
        f"tacshade-edge: {table}: tilt_x_deg: found 2 in all 12 rows that have it, expected values "
        "that differ"
    ]


def test_equal_depths_follow_no_label_and_say_nothing_else(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = own / "LABELS.csv"
    table.write_text("image,depth_mm\n" + "coin.png,1\ncoin.png,2\ncoin.png,3\n" * 4)
    assert main(of_own(own, "--labels", str(table), "--profile", "fast", "--json")) == 0
    printed = capsys.readouterr()
    assert without_progress(printed.err) == []
    (depth,) = json.loads(printed.out)["agreements"]["fast"]
    assert (depth["quantity"], depth["frames"], depth["rank_correlation"]) == ("depth", 12, None)


def test_invalid_images_are_refused_one_by_one_and_exit_1(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        cv2.imwrite(str(own / "images" / f"{name}.png"), BLACK)
        (own / "images" / f"{name}.npz").write_bytes((own / "images" / "coin.npz").read_bytes())
    assert main(of_own(own, "--profile", "fast", "balanced")) == 1
    printed = capsys.readouterr()
    first, second = without_progress(printed.err)
    assert first.startswith("tacshade-edge: a.png: invalid: ")
    assert second.startswith("tacshade-edge: b.png: invalid: ")
    *_, refused, _ = re.split(r"\s*\|\s*", printed.out.splitlines()[-1])
    assert refused == "2"


def test_labelled_frames_of_another_camera_are_said_to_be_so(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite(str(own / "images" / "large.png"), np.zeros((2 * HEIGHT, WIDTH), np.uint8))
    (own / "LABELS.csv").write_text("image,depth_mm\nlarge.png,1\n")
    assert main(of_own(own, "--labels", str(own / "LABELS.csv"), "--profile", "fast")) == 1
    found = (
        f"the first: size: found {WIDTH}x{2 * HEIGHT} px, expected the calibration's "
        f"{WIDTH}x{HEIGHT} px; are they"
    )
    assert f"{own}/images: every frame is invalid, {found}" in capsys.readouterr().err


@pytest.mark.slow
def test_an_image_without_truth_is_one_line_and_exit_1(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite(str(own / "images" / "alone.png"), TOUCHED)
    assert main(of_own(own)) == 1
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert "alone.npz: found no such file" in printed.err
    assert "coin" in printed.out
    (own / "images" / "coin.npz").unlink()
    assert main(of_own(own)) == 78
    assert "found no image to score" in capsys.readouterr().err.splitlines()[-1]
