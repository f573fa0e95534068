from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from calibrated_sensor import pressed
from sensor_files import write_files

from tacshade_edge.cli import main
from tacshade_edge.devices import calibration_file


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return write_files(tmp_path_factory.mktemp("sensor"))


def one_line(text: str) -> str:
    assert text.endswith("\n")
    assert text.count("\n") == 1
    assert text.startswith("tacshade-edge: ")
    assert "Traceback" not in text
    return text


def test_it_says_what_was_fitted(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "cal.npz"
    assert main(["calibrate", *words, "--out", str(out)]) == 0
    printed = capsys.readouterr()
    calibration = calibration_file.load(out)
    assert printed.err == ""
    assert f"{calibration.crc32:08x}" in printed.out
    for key in ("radius_px", "pitch_px", "mm_per_px", "depth_mae_mm", "depth_worst_mm"):
        assert f"  {key}: " in printed.out
    assert calibration.fit["presses"] > 15


def test_json_is_what_was_stored(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "cal.npz"
    assert main(["calibrate", *words, "--out", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    calibration = calibration_file.load(out)
    assert report["crc32"] == f"{calibration.crc32:08x}"
    assert report["pitch_px"] == pytest.approx(calibration.pitch_px, abs=1e-3)
    assert report["depth_mae_mm"] == pytest.approx(calibration.fit["depth_mae_mm"], abs=1e-4)
    assert isinstance(report["warnings"], list)


def test_without_presses_it_says_what_is_missing(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = [*words[:2], *words[4:6]]  # one reference
    assert main(["calibrate", *alone, "--out", str(tmp_path / "cal.npz")]) == 0
    printed = capsys.readouterr()
    assert "depth is not calibrated" in printed.out
    assert printed.err.startswith("warning: 1 reference: noise assumed")


def test_a_loaded_reference_needs_a_flag(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = tmp_path / "loaded.png"
    cv2.imwrite(str(image), pressed("cube", 3.0).image)
    command = ["calibrate", *words[:2], "--reference", str(image), "--out", str(tmp_path / "cal.npz")]
    assert main(command) == 78
    assert "taken under load" in one_line(capsys.readouterr().err)
    assert not (tmp_path / "cal.npz").exists()
    assert main([*command, "--allow-loaded-reference"]) == 0
    assert "warning: the reference seems taken under load" in capsys.readouterr().err


def test_bad_input_is_one_line_and_78(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    black, text = tmp_path / "black.png", tmp_path / "text.png"
    cv2.imwrite(str(black), np.zeros((240, 320), np.uint8))
    text.write_text("no image")
    cut = tmp_path / "cut.png"
    cut.write_bytes(Path(words[5]).read_bytes()[:1000])
    (tmp_path / "few.csv").write_text("image,indenter,radius_mm,depth_mm,x_mm,y_mm\n")
    out, sensor = str(tmp_path / "cal.npz"), words[:2]
    cases = {
        "none.yaml": ["--sensor", "none.yaml", *words[4:]],
        "black": [*sensor, "--reference", str(black)],
        "text.png": [*sensor, "--reference", str(text)],
        "cut.png": [*sensor, "--reference", str(cut)],
        "few.csv": [*sensor, "--presses", str(tmp_path / "few.csv"), *words[4:]],
        "none.csv": [*sensor, "--presses", "none.csv", *words[4:]],
    }
    for name, given in cases.items():
        assert main(["calibrate", *given, "--out", out]) == 78, name
        line = one_line(capsys.readouterr().err)
        assert name == "black" or name in line
        assert not Path(out).exists()


def test_a_result_that_cannot_be_written(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "none" / "cal.npz"
    assert main(["calibrate", *words[:2], *words[4:], "--out", str(out)]) == 1
    assert f"{out}: cannot write the calibration" in one_line(capsys.readouterr().err)


def test_the_process_exits_with_78(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tacshade_edge", "calibrate", "--sensor", "none.yaml", "--reference", "a.png"]
    done = subprocess.run([*command, "--out", "cal.npz"], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 78
    assert done.stdout == ""
    assert "none.yaml" in one_line(done.stderr)
