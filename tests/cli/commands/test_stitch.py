from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.bumpy_surface import APEX_MM
from support.calibrated_sensor import HALF, calibrated, unloaded
from support.flange_plan import exact_frames
from support.progress_lines import without_progress
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import main
from tacshade_edge.cli.commands import simulate, stitch
from tacshade_edge.rigid import Rigid, shift, turn

pytestmark = pytest.mark.slow

TRUE = shift(12, -7, 55) @ turn((0.3, -0.2, 1.1))
START = shift(6, 6, -5) @ TRUE


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, small_pad: None) -> Path:
    folder = tmp_path_factory.mktemp("pad")
    simulate.write_pad(HALF, folder, 5.0, 2.5, 0)
    calibration_file.save(folder / "cal.npz", calibrated())
    return folder


def words(folder: Path, out: Path, *more: str, poses: str = "POSES.csv") -> list[str]:
    stitch = ["stitch", "--calibration", str(folder / "cal.npz"), "--poses", str(folder / poses)]
    return [*stitch, "--out", str(out), "--profile", "fast", *more]


def test_the_files_keep_their_contract_and_come_out_the_same_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, again = tmp_path / "a", tmp_path / "b"
    assert main(words(folder, out, "--truth", str(folder / "PAD.npz"), "--json")) == 0
    about = json.loads(capsys.readouterr().out)
    assert about == json.loads((out / "map.json").read_text())
    with np.load(out / "map.npz") as npz:
        z, x0, y0, step = (npz[key] for key in ("z_mm", "x0_mm", "y0_mm", "step_mm"))
    assert z.dtype == np.float32
    assert z.shape == (about["rows"], about["cols"])
    assert (x0, y0, step) == (about["x0_mm"], about["y0_mm"], about["step_mm"])
    levels = cv2.imread(str(out / "map.png"), cv2.IMREAD_UNCHANGED)
    assert levels.dtype == np.uint16
    np.testing.assert_array_equal(levels == 0, np.isnan(z))
    from_png = about["png"]["z0_mm"] + (levels.astype(float) - 1) * about["png"]["scale_mm"]
    assert np.nanmax(np.abs(np.where(levels > 0, from_png, np.nan) - z)) <= about["png"]["scale_mm"]
    head, body = (out / "map.ply").read_bytes().split(b"end_header\n", 1)
    count = np.count_nonzero(np.isfinite(z))
    assert f"element vertex {count}\n".encode() in head
    assert np.frombuffer(body, "<f4").reshape(count, 3)[:, 2] == pytest.approx(z[np.isfinite(z)])
    assert max(cv2.imread(str(out / "preview.png")).shape) < 1000
    assert about["used"] == len(about["presses"]) == 12
    assert about["score"]["rms_mm"] < 0.5
    assert about["score"]["raised_coverage"] > 0.9
    assert {"rms_mm", "raised_coverage"} <= set(about["paper"])
    assert cv2.imread(str(out / "comparison.png")).std() > 10
    assert main(words(folder, again)) == 0
    for file in ("map.npz", "map.ply", "map.png", "preview.png"):
        assert (out / file).read_bytes() == (again / file).read_bytes()


def test_noisy_poses(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(words(folder, tmp_path, "--truth", str(folder / "PAD.npz"), poses="POSES_NOISY.csv"))
        == 0
    )
    printed = capsys.readouterr().out
    assert json.loads((tmp_path / "map.json").read_text())["refined"]
    assert all(
        said in printed for said in ("poses refined", "not refined: RMS", "paper's average: RMS")
    )


def test_the_papers_average_is_a_users_choice(folder: Path, tmp_path: Path) -> None:
    known = ("--truth", str(folder / "PAD.npz"))
    noisy = "POSES_NOISY.csv"
    maps = {}
    for fusion in ("tiles", "mean"):
        out = tmp_path / fusion
        assert main(words(folder, out, "--fusion", fusion, *known, poses=noisy)) == 0
        maps[fusion] = json.loads((out / "map.json").read_text())
        assert maps[fusion]["fusion"] == fusion
    tiles, mean = maps["tiles"], maps["mean"]
    assert mean["score"] == mean["paper"] == tiles["paper"]
    assert mean["score"]["rms_mm"] > tiles["score"]["rms_mm"]
    assert not mean["refined"]
    assert mean["used"] == 12
    assert {press["moved_mm"] for press in mean["presses"]} == {0.0}


def recorded(folder: Path, path: Path, *, poses: bool = True) -> Path:
    """A robot that presses three times and holds still for half a second, at 30 frames a second."""
    path.mkdir()
    rows, t_ns = ["image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz"], 0
    cv2.imwrite(str(path / "free.png"), unloaded())
    for line in (folder / "POSES.csv").read_text().splitlines()[1:4]:
        name, numbers = line.split(",", 1)
        shutil.copy(folder / name, path / name)
        for image in ("free.png",) * 3 + (name,) * 15:
            t_ns += 33_333_333
            rows.append(f"{image},{t_ns},{numbers if poses else ',,,,,,'}")
    (path / "frames.csv").write_text("\n".join(rows) + "\n")
    return path


def test_a_recording_is_the_presses_in_it(folder: Path, tmp_path: Path) -> None:
    recording = recorded(folder, tmp_path / "recording")
    lines = (folder / "POSES.csv").read_text().splitlines()[:4]
    (recording / "POSES.csv").write_text("\n".join(lines) + "\n")
    given = ["stitch", "--calibration", str(folder / "cal.npz"), "--profile", "fast"]
    assert main([*given, "--recording", str(recording), "--out", str(tmp_path / "a")]) == 0
    assert (
        main([*given, "--poses", str(recording / "POSES.csv"), "--out", str(tmp_path / "b")]) == 0
    )
    assert (tmp_path / "a" / "map.ply").read_bytes() == (tmp_path / "b" / "map.ply").read_bytes()
    assert json.loads((tmp_path / "a" / "map.json").read_text())["used"] == 3


def test_images_that_cannot_be_used(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(folder, tmp_path / "pad")
    cv2.imwrite(str(tmp_path / "pad" / "press_0000.png"), unloaded())
    (tmp_path / "pad" / "press_0001.png").unlink()
    cv2.imwrite(str(tmp_path / "pad" / "press_0002.png"), unloaded()[:-20])
    assert main(words(tmp_path / "pad", tmp_path / "out")) == 1
    first, second = without_progress(capsys.readouterr().err)
    assert "POSES.csv:3: " in first
    assert "press_0001.png: No such file" in first
    assert "POSES.csv:4: " in second
    records = json.loads((tmp_path / "out" / "map.json").read_text())["presses"]
    assert [r["used"] for r in records[:4]] == [False, False, False, True]
    assert records[0]["reason"] == "no contact"


def untouched(pad: Path) -> None:
    for path in pad.glob("press_*.png"):
        cv2.imwrite(str(path), unloaded())


def no_number(pad: Path) -> None:
    first, second, *rest = (pad / "POSES.csv").read_text().splitlines()
    (pad / "POSES.csv").write_text(
        "\n".join((first, second.replace(second.split(",")[1], "nan"), *rest))
    )


@pytest.mark.parametrize(
    ("change", "more", "place"),
    [
        (untouched, (), "no contact"),
        (no_number, ("--find-flange",), "POSES.csv:2: x_mm: "),
        (
            lambda pad: (pad / "PAD.npz").write_text("nothing"),
            ("--truth", "{pad}/PAD.npz"),
            "PAD.npz: ",
        ),
        (lambda _: None, ("--find-flange",), "POSES.csv: translation along x, y, z"),
        (lambda _: None, ("--find-flange", "--truth", "{pad}/PAD.npz"), "--truth: "),
        (lambda _: None, ("--find-flange", "--fusion", "mean"), "--fusion: "),
        (lambda pad: recorded(pad, pad / "rec", poses=False), ("--recording", "{pad}/rec"), ""),
        (
            lambda pad: recorded(pad, pad / "rec"),
            ("--find-flange", "--recording", "{pad}/rec"),
            "expected at least 12",
        ),
    ],
)
def test_what_cannot_be_stitched_is_one_line(
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    change: Callable[[Path], object],
    more: tuple[str, ...],
    place: str,
) -> None:
    pad = tmp_path / "pad"
    shutil.copytree(folder, pad)
    change(pad)
    given = words(pad, tmp_path / "out", *(word.format(pad=pad) for word in more))
    if "--recording" in given:
        del given[3:5]
    assert main(given) == 78
    (line,) = without_progress(capsys.readouterr().err)
    assert place in line
    assert not (tmp_path / "out").exists()


def test_presses_too_far_apart_and_a_folder_that_cannot_be_written(
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "file").write_text("")
    assert main(words(folder, tmp_path / "file" / "out")) == 1
    assert "cannot write it" in capsys.readouterr().err
    monkeypatch.setattr("tacshade_edge.stitching.stitcher.TILES_MAX", 2)
    assert main(words(folder, tmp_path / "out")) == 78
    (line,) = without_progress(capsys.readouterr().err)
    assert "the map would exceed 2 tiles of 16 mm" in line


def report_flange(
    tmp_path: Path, *, start: Rigid = START, as_json: bool = False, moves: bool = True
) -> None:
    frames = exact_frames(TRUE, 20.0, moving=moves)
    stitch.report_flange(frames, start, APEX_MM, tmp_path, "POSES.csv", as_json=as_json)


def test_the_flange_that_is_printed_goes_into_the_settings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report_flange(tmp_path)
    first, settings, delay = capsys.readouterr().out.splitlines()
    about = json.loads((tmp_path / "flange.json").read_text())
    assert about["flange_T_sensor"] == pytest.approx(TRUE.seven(), abs=0.3)
    assert first.startswith(f"{tmp_path / 'flange.json'}: 100 presses; 9.")
    line = settings.partition("flange_T_sensor: [")[2].partition("]")[0]
    assert [float(value) for value in line.split(",")] == pytest.approx(
        about["flange_T_sensor"], rel=1e-5, abs=1e-5
    )
    assert delay.startswith("delay: frames are stamped ")
    assert about["delay_ms"] == pytest.approx(20, abs=5)


def test_without_motion_the_delay_is_null(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report_flange(tmp_path, moves=False, as_json=True)
    about = json.loads(capsys.readouterr().out)
    assert about == json.loads((tmp_path / "flange.json").read_text())
    assert about["delay_ms"] is None


def test_poses_in_another_unit_or_one_for_all_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    head, *rows = (folder / "POSES.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]

    def said(name: str, changed: list[list[str]], *more: str) -> str:
        wrong = folder / name
        wrong.write_text("\n".join([head, *map(",".join, changed)]) + "\n")
        assert main(words(folder, tmp_path / "map", *more, poses=name)) == 78
        assert not (tmp_path / "map").exists()
        (line,) = without_progress(capsys.readouterr().err)
        assert line.startswith(f"tacshade-edge: {wrong}: ")
        return line

    metres = [[a, *(f"{float(v) / 1000:.6f}" for v in b[:3]), *b[3:]] for a, *b in cells]
    line = said("METRES.csv", metres)
    assert "x_mm, y_mm, z_mm span 0.0" in line
    assert line.endswith("are they in m?")
    same = [[a, *cells[0][1:]] for a, *_ in cells]
    assert "one pose for all" in said("SAME.csv", same)
    assert "one pose for all" in said("SAME.csv", same, "--find-flange")
