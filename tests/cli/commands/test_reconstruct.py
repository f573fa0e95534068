from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.calibrated_sensor import calibrated, pressed, reconstructor, unloaded
from support.progress_lines import without_progress
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import main
from tacshade_edge.files.drawing import BAR_WIDTH_PX, LEFT_PX, RIGHT_PX
from tacshade_edge.types import U8

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
    return {
        Path(record["image"]).stem: record
        for record in json.loads((out / "summary.json").read_text())
    }


@pytest.mark.parametrize("profile", ["paper", "balanced"])
def test_the_files_keep_their_contract(folder: Path, tmp_path: Path, profile: str) -> None:
    assert (
        main([*words(folder, tmp_path, "ball", "two", "free", "black"), "--profile", profile]) == 1
    )
    records = summary(tmp_path)
    assert list(records) == ["ball", "two", "free", "black"]
    grid, inside = reconstructor(profile).grid, reconstructor(profile).rays.inside
    for name, record in records.items():
        with np.load(tmp_path / f"{name}.npz") as npz:
            content = {key: npz[key] for key in npz.files}
        height, contact, points, labels = (
            content[k] for k in ("height_mm", "contact", "points_mm", "labels")
        )
        assert (height.dtype, contact.dtype, points.dtype) == (np.float32, np.bool_, np.float32)
        assert np.issubdtype(labels.dtype, np.integer)
        assert height.shape == contact.shape == inside.shape
        assert (content["row0"], content["col0"], content["step_px"]) == (
            grid.row0,
            grid.col0,
            grid.step_px,
        )
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
        assert record["contact"] == (contact.any() if record["valid"] else None)
        assert record["elapsed_ms"]["total"] >= record["elapsed_ms"]["check"] >= 0
        assert {"valid", "reason", "saturated", "depth_max_mm"} <= set(record)
        for o in objects:
            mine = points[labels == o["label"]].astype(float)
            np.testing.assert_allclose(o["centroid_mm"], mine.mean(axis=0), atol=1e-3)
            np.testing.assert_allclose(o["extent_mm"], np.ptp(mine, axis=0), atol=1e-3)
            assert 0 < o["depth_max_mm"] <= record["depth_max_mm"]
        if not record["contact"]:
            assert (height[inside] == 0).all()
            assert record["depth_max_mm"] == (0 if record["valid"] else None)
    assert records["ball"]["contact"]
    assert records["free"]["valid"]
    assert records["free"]["reason"] == ""
    assert not records["black"]["valid"]
    assert records["black"]["reason"].startswith("black")


def test_objects_and_depth_of_fast(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words(folder, tmp_path, "ball", "two"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == list(summary(tmp_path).values())
    ball, two = printed
    assert ball["depth_max_mm"] == pytest.approx(3.0, rel=0.25)
    assert len(two["objects"]) == 2


@pytest.mark.slow
def test_a_touch_of_unknown_depth_is_counted_and_has_no_depth(
    faint: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration, pictures = map(str, faint)
    out = tmp_path / "out"
    command = ["reconstruct", pictures, "--calibration", calibration, "--profile", "fast"]
    assert main([*command, "--out", str(out), "--plot"]) == 0
    found = "2 of 2 images reconstructed, 0 in contact, 1 touched (depth unknown), 0 invalid"
    assert found in capsys.readouterr().out
    free, touched = json.loads((out / "summary.json").read_text())
    assert (free["touched"], free["depth_max_mm"]) == (False, 0)
    assert (touched["touched"], touched["contact"]) == (True, False)
    assert touched["depth_max_mm"] is None


def test_a_folder_is_its_images_in_order_and_bad_ones_are_counted_and_named(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = tmp_path / "given"
    given.mkdir()
    for name in ("ball", "black", "cut", "other"):
        (given / f"{name}.png").symlink_to(folder / f"{name}.png")
    (given / "LABELS.csv").write_text("image\n")
    out = tmp_path / "out"
    assert main([*words(folder, out, "none", "free"), str(given), "--plot"]) == 1
    printed = capsys.readouterr()
    assert (
        printed.out
        == f"{out}: 2 of 6 images reconstructed, 1 in contact, 2 invalid, 2 unreadable\n"
    )
    none, black, cut, other = without_progress(printed.err)
    assert "none.png: No such file" in none
    assert black.startswith(f"tacshade-edge: {given}/black.png: invalid: black")
    assert "cut.png: found an image cut short after 5000 bytes" in cut
    assert other.endswith(
        "other.png: invalid: size: found 320x220 px, expected the calibration's 320x240 px"
    )
    assert list(summary(out)) == ["free", "ball", "black", "other"]
    with np.load(out / "other.npz") as npz:
        np.testing.assert_array_equal(npz["height_mm"] == 0, reconstructor("balanced").rays.inside)
    for name in ("ball", "black"):
        assert (
            cv2.imread(str(out / f"{name}.png")).shape[1]
            == 3 * (LEFT_PX + RIGHT_PX) + 2 * 320 + BAR_WIDTH_PX
        )
    assert cv2.imread(str(out / "contact-sheet.png")) is not None
    (tmp_path / "empty").mkdir()
    assert main([*words(folder, out), str(tmp_path / "empty")]) == 78
    assert "empty: found no image" in capsys.readouterr().err


def test_more_pictures_than_a_sheet_holds_are_on_the_next(
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("tacshade_edge.cli.commands.reconstruct.SHEET_TILES", 2)
    out = tmp_path / "out"
    assert main([*words(folder, out, "ball", "two", "free"), "--plot"]) == 0
    assert capsys.readouterr().out.endswith("0 unreadable; 2 contact sheets\n")
    sheets = [cv2.imread(str(out / f"contact-sheet{end}.png")) for end in ("", "-2")]
    assert sheets[0].shape[1] == sheets[1].shape[1]
    assert not (out / "contact-sheet-3.png").exists()


def test_a_surface_is_the_skin_in_mm(folder: Path, tmp_path: Path) -> None:
    assert main([*words(folder, tmp_path, "ball", "black"), "--mesh"]) == 1
    assert not (tmp_path / "black.ply").exists()
    head, _, data = (tmp_path / "ball.ply").read_bytes().partition(b"end_header\n")
    counts = [int(line.split()[-1]) for line in head.splitlines() if line.startswith(b"element")]
    vertex = np.dtype([("xyz", "<f4", 3), ("quality", "<f4"), ("bgr", "u1", 3)])
    vertices = np.frombuffer(data, vertex, counts[0])
    faces = np.frombuffer(data, [("n", "u1"), ("at", "<i4", 3)], offset=vertices.nbytes)
    assert len(faces) == counts[1]
    assert (faces["n"] == 3).all()
    with np.load(tmp_path / "ball.npz") as npz:
        height_mm, contact, points_mm = npz["height_mm"], npz["contact"], npz["points_mm"]
    np.testing.assert_array_equal(vertices["quality"], height_mm[np.isfinite(height_mm)])
    touched = vertices["xyz"][contact[np.isfinite(height_mm)]]
    apart_mm = np.linalg.norm(touched[:, None] - points_mm[None], axis=2)
    assert apart_mm.min(axis=0).max() < 1e-3
    a, b, c = np.moveaxis(vertices["xyz"][faces["at"]].astype(float), 1, 0)
    assert np.median(np.cross(b - a, c - a)[:, 2]) > 0  # seen from outside


def test_pictures_of_another_size_are_named_and_the_rest_is_on_the_sheet(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given, out = tmp_path / "given", tmp_path / "out"
    given.mkdir()
    sizes = [(640, 40), (40, 640), (1, 1000), (1000, 1), (3, 8000), (8192, 16), (16, 16), (1, 1)]
    for width, height in sizes:
        picture = np.full((height, width, 3), 99, np.uint8)
        cv2.imwrite(str(given / f"{width:04}x{height}.png"), picture)
    assert main([*words(folder, out), str(given), "--plot"]) == 1
    assert not (out / "contact-sheet.png").exists()
    reasons = [record["reason"] for record in summary(out).values()]
    assert sorted(reasons) == sorted(
        f"size: found {width}x{height} px, expected the calibration's 320x240 px"
        for width, height in sizes
    )
    said = capsys.readouterr().err
    assert said.count(": invalid: size: found ") == len(sizes)
    assert f"every image is invalid: are they of {folder}/cal.npz's sensor?" in said
    assert main([*words(folder, tmp_path / "ball", "ball"), "--plot"]) == 0
    assert main([*words(folder, out, "ball"), str(given), "--plot"]) == 1
    alone, sheet = (
        cv2.imread(str(each / "contact-sheet.png")) for each in (tmp_path / "ball", out)
    )
    np.testing.assert_array_equal(sheet, alone)


def test_a_damaged_calibration_is_one_line_and_78(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = (folder / "cal.npz").read_bytes()
    (tmp_path / "cal.npz").write_bytes(whole[: len(whole) // 2])
    assert main(words(folder, tmp_path / "cal.npz", "ball")) == 1
    assert "cal.npz: cannot write it" in capsys.readouterr().err
    assert main(words(folder, tmp_path / "out", "ball", "free", "ball")) == 78
    assert "another image is also named ball" in capsys.readouterr().err
    assert main([*words(tmp_path, tmp_path / "out"), str(folder / "ball.png")]) == 78
    assert "cal.npz: the file is damaged or not a calibration" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_outline_is_the_papers_if_it_is_asked_for(folder: Path, tmp_path: Path) -> None:
    areas = {}
    for outline in ("network", "kmeans"):
        out = tmp_path / outline
        assert main([*words(folder, out, "ball", "free"), "--outline", outline]) == 0
        records = summary(out)
        assert not records["free"]["contact"]
        (found,) = records["ball"]["objects"]
        areas[outline] = found["area_mm2"]
    assert areas["network"] != areas["kmeans"]
