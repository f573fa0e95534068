from __future__ import annotations

import json
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from support.calibrated_sensor import HALF
from support.csv_rows import csv_rows
from support.progress_lines import only_progress
from tacshade_edge.cli import main
from tacshade_edge.cli.commands import simulate
from tacshade_edge.lab.simulator.tacshade import OBJECT_SCALE
from tacshade_edge.settings import Simulated, load

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def half(monkeypatch: pytest.MonkeyPatch) -> None:
    """A camera of half the resolution."""
    monkeypatch.setattr(simulate, "SensorModel", lambda: HALF)


def test_scenes_have_images_and_their_ground_truth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "simulate",
        "--out",
        str(tmp_path),
        "--objects",
        "none,cube",
        "--depth",
        "3",
        "--position",
        "-3",
        "1",
    ]
    assert main([*words, "--drag", "2", "-1", "--twist", "8", "--tilt", "5", "0"]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith(
        f"{tmp_path}: 2 images with ground truth, scenes.csv\nnext:\n  tacshade-edge simulate "
    )
    assert only_progress(printed.err)
    none, cube = csv_rows(tmp_path / "scenes.csv")
    assert (none["object"], float(none["depth_max_mm"])) == ("none", 0.0)
    stated = {
        "depth_mm": "3.0",
        "x_mm": "-3.0",
        "y_mm": "1.0",
        "drag_x_mm": "2.0",
        "twist_deg": "8.0",
    }
    assert {name: cube[name] for name in stated} == stated
    image = cv2.imread(str(tmp_path / cube["image"]))
    with np.load(tmp_path / Path(none["image"]).with_suffix(".npz")) as truth:
        assert (truth["shear_mm"][np.isfinite(truth["height_mm"])] == 0).all()
    with np.load(tmp_path / Path(cube["image"]).with_suffix(".npz")) as truth:
        height, shear = truth["height_mm"], truth["shear_mm"]
        assert image.shape[:2] == height.shape == truth["contact"].shape == shear.shape[:2]
        assert (truth["row0"], truth["col0"], truth["step_px"]) == (0, 0, 1)
        assert height.dtype == np.float32
        assert np.nanmax(height) == pytest.approx(float(cube["depth_max_mm"]), abs=1e-3)
        assert len(truth["points_mm"]) == truth["contact"].sum() > 300
        assert (np.isnan(shear).all(axis=2) == np.isnan(height)).all()
        assert shear[truth["contact"]].mean(axis=0) == pytest.approx((2, -1), abs=0.4)
        assert (str(truth["object"]), float(truth["twist_deg"])) == ("cube", 8)


def test_the_identified_tacshade_is_pressed_by_objects_of_its_size(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["simulate", "--model", "tacshade", "--objects", "cube", "--depth", "2"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    assert f"simulate --calibration-set {tmp_path}/sensor --model tacshade\n" in (
        capsys.readouterr().out
    )
    with np.load(tmp_path / "000_cube.npz") as truth:
        width_mm = np.ptp(truth["points_mm"][:, 0])
    assert width_mm == pytest.approx(10 * OBJECT_SCALE, abs=1.0)
    with pytest.raises(SystemExit):
        main([*words, "--sensor-seed", "3", "--out", str(tmp_path)])
    assert "not allowed with argument" in capsys.readouterr().err


def test_a_calibration_set_is_complete_repeatable_and_its_commands_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, two = tmp_path / "one", tmp_path / "my practice"
    for folder in (one, two):
        assert (
            main(["simulate", "--calibration-set", str(folder), "--presses", "8", "--seed", "5"])
            == 0
        )
    assert set(yaml.safe_load((one / "SENSOR.yaml").read_text())) == {
        "skin_radius_mm",
        "camera_distance_mm",
        "visible_half_angle_deg",
        "polarity",
    }
    rows = csv_rows(one / "PRESSES.csv")
    assert list(rows[0]) == ["image", "indenter", "radius_mm", "depth_mm", "x_mm", "y_mm"]
    names = sorted(path.name for path in one.iterdir())
    assert len(names) == 8 + 8 + 3
    assert all((one / name).read_bytes() == (two / name).read_bytes() for name in names)
    first, second = (cv2.imread(str(one / f"reference_0{k}.png")).astype(int) for k in (0, 1))
    assert 0 < np.abs(first - second).mean() < 10  # the same scene with other noise
    *_, calibrate, run = capsys.readouterr().out.splitlines()
    assert "--fit" in calibrate
    assert main(expanded(calibrate.replace("--fit", ""))) == 0  # it takes minutes
    assert expanded(run)[:-1] == ["run", "--config"]
    settings = load(Path(expanded(run)[-1])).settings
    assert Path(settings.calibration).exists()
    assert settings.source == Simulated()
    assert settings.recorder.folder == str(two / "recordings")


def expanded(line: str) -> list[str]:
    """The words of a command after its name, with a pattern's files, as a shell has them."""
    words: list[str] = []
    for word in shlex.split(line)[1:]:
        at = Path(word)
        words += sorted(map(str, at.parent.glob(at.name))) if "*" in word else [word]
    return words


def test_a_pad_is_calibrated_and_stitched_by_the_commands_that_it_prints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], small_pad: None
) -> None:
    assert main(["simulate", "--pad", str(tmp_path / "pad"), "--pad-step", "5"]) == 0
    said, _, calibrate, stitch = capsys.readouterr().out.splitlines()
    assert said.startswith(f"{tmp_path}/pad: 12 presses, POSES.csv, POSES_NOISY.csv, PAD.npz, ")
    assert main(expanded(calibrate)) == 0
    assert main([*expanded(stitch), "--profile", "fast"]) == 0
    assert "12 of 12 presses" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--out", "OUT", "--objects", "teapot"], 78, "found 'teapot'"),
        (["--out", "OUT", "--objects", "ball", "--position", "30", "0"], 78, "not over the skin"),
        (["--out", "FILE/x", "--objects", "none"], 1, "cannot write it"),
        (["--pad", "OUT", "--pad-step", "0"], 78, "found a step of 0 mm"),
    ],
)
def test_what_cannot_be_is_one_line(
    words: list[str], code: int, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "FILE").write_text("a file in the way")
    assert (
        main(
            [
                "simulate",
                *(
                    str(tmp_path / word) if word.isupper() or "/" in word else word
                    for word in words
                ),
            ]
        )
        == code
    )
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert message in error


def test_a_pad_is_calibrated_like_a_dome(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    at, out = tmp_path / "sensor", tmp_path / "scenes"
    words = ["--calibration-set", str(at), "--presses", "10", "--out", str(out)]
    assert main(["simulate", "--skin", "pad", *words, "--objects", "none,ball"]) == 0
    assert "--calibration-set" in (printed := capsys.readouterr().out)
    assert " --skin pad" in printed
    stated = yaml.safe_load((at / "SENSOR.yaml").read_text(encoding="utf-8"))
    assert stated["skin"] == "pad"
    assert stated["visible_radius_mm"] == pytest.approx(HALF.geometry.visible_radius_mm, abs=1e-3)
    assert "skin_radius_mm" not in stated
    made = str(at / "calibration.npz")
    given = ["--sensor", str(at / "SENSOR.yaml"), "--reference", *map(str, at.glob("reference_*"))]
    presses = ["--presses", str(at / "PRESSES.csv")]
    assert main(["calibrate", *given, *presses, "--out", made]) == 0
    capsys.readouterr()
    assert main(["evaluate", "--images", str(out), "--calibration", made, "--json"]) == 0
    ball = json.loads(capsys.readouterr().out)["profiles"]["balanced"]["objects"]["ball"]
    assert (ball["presses"], ball["found"]) == (1, 1)
    assert ball["me_mm"] < 1
    images = [str(path) for path in sorted(out.glob("*.png"))]
    assert main(["reconstruct", "--calibration", made, "--out", str(tmp_path / "r"), *images]) == 0
    none, pressed = json.loads((tmp_path / "r" / "summary.json").read_text(encoding="utf-8"))
    assert (none["contact"], pressed["contact"]) == (False, True)
    assert pressed["depth_max_mm"] == pytest.approx(3.0, abs=1.0)
    assert main(["calibrate", *given, "--fit", "--out", made]) == 78
    assert "states a pad or a dome of less than 25 degrees" in capsys.readouterr().err
