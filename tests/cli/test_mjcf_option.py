"""``simulate --mjcf``: what is written, and what is refused."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from support.calibrated_sensor import calibrated
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import main

FILES = {"sensor.xml", "scene.xml", "skin.msh", "taxels.msh"}


def test_a_stated_sensor_is_four_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "mjcf"
    words = ["simulate", "--mjcf", str(folder), "--skin", "pad"]
    assert main([*words, "--mechanics", "1.5", "0.5"]) == 0
    assert {path.name for path in folder.iterdir()} == FILES
    printed = capsys.readouterr().out
    assert f"{folder}: sensor.xml, " in printed
    assert "a pad with a skin that decays over 1.5 mm, friction 0.5\n" in printed
    text = (folder / "sensor.xml").read_text(encoding="utf-8")
    assert '"skin":"pad"' in text
    assert '"skin_decay_mm":1.5,"friction":0.5' in text


def test_a_calibrated_sensor_has_its_size_and_flange(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = calibrated()
    path = tmp_path / "cal.npz"
    calibration_file.save(path, known)
    assert main(["simulate", "--mjcf", str(tmp_path), "--calibration", str(path)]) == 0
    text = (tmp_path / "sensor.xml").read_text(encoding="utf-8")
    found = re.search(r'"skin_radius_mm":([\d.]+)', text)
    assert found is not None
    assert float(found[1]) == known.geometry.skin_radius_mm
    assert "a dome with" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["--calibration", "cal.npz"], ["--mechanics", "2", "1"]])
def test_what_only_mjcf_reads_requires_it(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["simulate", "--out", str(tmp_path), *words])
    assert end.value.code == 2
    assert f"{words[0]} requires --mjcf DIR" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["--mechanics", "-1", "1"], "skin_decay_mm"),
        (["--mechanics", "2", "1.5"], "friction"),
        (["--calibration", "/dev/null"], "/dev/null: "),
    ],
)
def test_a_sensor_that_cannot_be_is_refused_in_one_line(
    words: list[str], found: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", "--mjcf", str(tmp_path / "mjcf"), *words]) == 78
    (line,) = capfd.readouterr().err.splitlines()
    assert found in line
    assert not (tmp_path / "mjcf").exists()
