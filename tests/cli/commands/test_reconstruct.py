from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.calibrated_sensor import calibrated, pressed, reconstructor, unloaded
from support.progress_lines import without_progress

from tacshade_edge.cli import main
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.pictures import BAR_PX, LEFT_PX, RIGHT_PX
from tacshade_edge.types import U8
from tools.testbed.patience import patience

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("images")
    calibration_file.save(folder / "cal.npz", calibrated())
    images: dict[str, U8] = {
        "ball": pressed("ball", 3.0).image,
        "two": pressed("two_balls", 3.0).image,
        "free": unloaded(),
        "black": unloaded() * 0,
        "other": unloaded()[:-20],
    }
    for name, image in images.items():
        cv2.imwrite(str(folder / f"{name}.png"), image)
    (folder / "cut.png").write_bytes((folder / "ball.png").read_bytes()[:5000])
    return folder


def words(folder: Path, out: Path, *names: str) -> list[str]:
    images = [str(folder / f"{name}.png") for name in names]
    return ["reconstruct", "--calibration", str(folder / "cal.npz"), "--out", str(out), *images]


def summary(out: Path) -> dict[str, dict[str, Any]]:
    return {Path(record["image"]).stem: record for record in json.loads((out / "summary.json").read_text())}


@pytest.mark.parametrize("profile", PROFILES)
def test_the_files_keep_their_contract(folder: Path, tmp_path: Path, profile: str) -> None:
    assert main([*words(folder, tmp_path, "ball", "two", "free", "black"), "--profile", profile]) == 1
    records = summary(tmp_path)
    assert list(records) == ["ball", "two", "free", "black"]
    grid, inside = reconstructor(profile).grid, reconstructor(profile).rays.inside
    for name, record in records.items():
        with np.load(tmp_path / f"{name}.npz") as npz:
            content = {key: npz[key] for key in npz.files}
        height, contact, points, labels = (content[k] for k in ("height_mm", "contact", "points_mm", "labels"))
        assert (height.dtype, contact.dtype, points.dtype) == (np.float32, np.bool_, np.float32)
        assert np.issubdtype(labels.dtype, np.integer)
        assert height.shape == contact.shape == inside.shape
        assert (content["row0"], content["col0"], content["step_px"]) == (grid.row0, grid.col0, grid.step_px)
        assert ("sigma_mm" in content) == (profile != "paper")
        if profile != "paper":
            assert content["sigma_mm"].dtype == np.float32
            np.testing.assert_array_equal(np.isfinite(content["sigma_mm"]), contact)
        np.testing.assert_array_equal(np.isnan(height), ~inside)
        assert points.shape == (np.count_nonzero(contact), 3)
        assert labels.shape == (len(points),)
        objects = record["objects"]
        assert sorted(set(labels.tolist())) == [o["label"] for o in objects]
        assert record["profile"] == profile
        assert record["contact"] == contact.any()
        assert record["elapsed_ms"]["total"] >= record["elapsed_ms"]["check"] >= 0
        assert {"valid", "reason", "saturated", "depth_max_mm"} <= set(record)
        for o in objects:
            mine = points[labels == o["label"]].astype(float)
            np.testing.assert_allclose(o["centroid_mm"], mine.mean(axis=0), atol=1e-3)
            np.testing.assert_allclose(o["extent_mm"], np.ptp(mine, axis=0), atol=1e-3)
            assert 0 < o["depth_max_mm"] <= record["depth_max_mm"]
        if not record["contact"]:
            assert (height[inside] == 0).all()
            assert record["depth_max_mm"] == 0
    assert records["ball"]["contact"]
    assert records["free"]["valid"]
    assert records["free"]["reason"] == ""
    assert not records["black"]["valid"]
    assert records["black"]["reason"].startswith("black")


def test_objects_and_depth_of_fast(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words(folder, tmp_path, "ball", "two"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == list(summary(tmp_path).values())
    ball, two = printed
    assert ball["depth_max_mm"] == pytest.approx(3.0, rel=0.25)
    assert len(two["objects"]) == 2


def test_an_unreadable_image_does_not_stop_the_others(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words(folder, tmp_path, "cut", "ball", "none")) == 1
    first, second = without_progress(capsys.readouterr().err)
    assert "cut.png: found an image cut short after 5000 bytes" in first
    assert "none.png: No such file" in second
    assert list(summary(tmp_path)) == ["ball"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["ball.npz", "summary.json"]


def test_invalid_images_are_counted_and_named(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words(folder, tmp_path, "black", "ball", "other", "cut")) == 1
    printed = capsys.readouterr()
    assert printed.out == f"{tmp_path}: 1 of 4 images reconstructed, 1 in contact, 2 invalid, 1 unreadable\n"
    black, other, cut = without_progress(printed.err)
    assert black.startswith(f"tacshade-edge: {folder}/black.png: invalid: black")
    assert (
        other
        == f"tacshade-edge: {folder}/other.png: invalid: size: found 320x220 px, expected the calibration's 320x240 px"
    )
    assert "cut.png: found an image cut short" in cut
    assert main(words(folder, tmp_path, "ball", "free")) == 0
    assert capsys.readouterr() == (
        f"{tmp_path}: 2 of 2 images reconstructed, 1 in contact, 0 invalid, 0 unreadable\n",
        "",
    )


def test_an_image_of_another_size_is_an_invalid_frame(folder: Path, tmp_path: Path) -> None:
    main(words(folder, tmp_path, "other"))
    record = summary(tmp_path)["other"]
    assert not record["valid"]
    assert record["reason"] == "size: found 320x220 px, expected the calibration's 320x240 px"
    with np.load(tmp_path / "other.npz") as npz:
        np.testing.assert_array_equal(npz["height_mm"] == 0, reconstructor("balanced").rays.inside)


def test_a_picture_per_image(folder: Path, tmp_path: Path) -> None:
    assert main([*words(folder, tmp_path, "ball", "black"), "--plot"]) == 1
    for name in ("ball", "black"):
        assert cv2.imread(str(tmp_path / f"{name}.png")).shape[1] == 2 * (LEFT_PX + 320 + RIGHT_PX) + BAR_PX


def test_two_images_of_one_name_are_refused(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words(folder, tmp_path, "ball", "free", "ball")) == 78
    assert "another image is also named ball" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_is_a_file(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").touch()
    assert main(words(folder, tmp_path / "out", "ball")) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert str(tmp_path / "out") in err


def test_an_unknown_profile_is_a_usage_error(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([*words(folder, tmp_path, "ball"), "--profile", "best"])
    assert stop.value.code == 2
    assert "invalid choice: 'best'" in capsys.readouterr().err


def test_a_damaged_calibration_ends_the_process_with_78(folder: Path, tmp_path: Path) -> None:
    whole = (folder / "cal.npz").read_bytes()
    (tmp_path / "cal.npz").write_bytes(whole[: len(whole) // 2])
    given = [*words(tmp_path, tmp_path / "out"), str(folder / "ball.png")]
    command = [sys.executable, "-m", "tacshade_edge", *given]
    done = subprocess.run(command, capture_output=True, text=True, timeout=patience(60))
    assert done.returncode == 78
    assert done.stderr.count("\n") == 1
    assert "cal.npz: the file is damaged or not a calibration" in done.stderr
    assert not (tmp_path / "out").exists()
