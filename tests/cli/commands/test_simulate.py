import csv
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from tacshade_edge.cli import main
from tacshade_edge.settings import load
from tacshade_edge.settings.model import Simulated

pytestmark = pytest.mark.slow


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_scenes_have_images_and_their_ground_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["simulate", "--out", str(tmp_path), "--objects", "none,ball", "--depth", "2", "--position", "-3", "1"]
    assert main(words) == 0
    printed = capsys.readouterr()
    assert printed.out == f"{tmp_path}: 2 images with ground truth, scenes.csv\n"
    assert printed.err == ""
    none, ball = table(tmp_path / "scenes.csv")
    assert (none["object"], float(none["depth_max_mm"])) == ("none", 0.0)
    assert (ball["object"], ball["depth_mm"], ball["x_mm"], ball["y_mm"]) == ("ball", "2.0", "-3.0", "1.0")
    image = cv2.imread(str(tmp_path / ball["image"]))
    with np.load(tmp_path / Path(ball["image"]).with_suffix(".npz")) as truth:
        assert image.shape[:2] == truth["height_mm"].shape == truth["contact"].shape
        assert (truth["row0"], truth["col0"], truth["step_px"]) == (0, 0, 1)
        assert truth["height_mm"].dtype == np.float32
        assert np.nanmax(truth["height_mm"]) == pytest.approx(float(ball["depth_max_mm"]), abs=1e-3)
        assert len(truth["points_mm"]) == truth["contact"].sum() > 1000
        assert str(truth["object"]) == "ball"


def test_a_dragged_scene_has_its_shear(tmp_path: Path) -> None:
    words = ["simulate", "--out", str(tmp_path), "--objects", "none,cube", "--depth", "3", "--drag", "2", "-1"]
    assert main([*words, "--twist", "8", "--tilt", "5", "0"]) == 0
    none, cube = table(tmp_path / "scenes.csv")
    assert (cube["drag_x_mm"], cube["drag_y_mm"], cube["twist_deg"], cube["tilt_x_deg"]) == (
        "2.0",
        "-1.0",
        "8.0",
        "5.0",
    )
    with np.load(tmp_path / Path(none["image"]).with_suffix(".npz")) as truth:
        assert (truth["shear_mm"][np.isfinite(truth["height_mm"])] == 0).all()
    with np.load(tmp_path / Path(cube["image"]).with_suffix(".npz")) as truth:
        height, shear = truth["height_mm"], truth["shear_mm"]
        assert shear.shape == (*height.shape, 2)
        assert (np.isnan(shear).all(axis=2) == np.isnan(height)).all()
        assert shear[truth["contact"]].mean(axis=0) == pytest.approx((2, -1), abs=0.4)
        assert float(truth["twist_deg"]) == 8


def test_calibration_set_is_complete_and_repeatable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one", "two"):
        words = ["simulate", "--calibration-set", str(tmp_path / name), "--presses", "3", "--seed", "5"]
        assert main([*words, "--sensor-seed", "2"]) == 0
    assert "8 references, 3 ball presses" in capsys.readouterr().out
    one, two = tmp_path / "one", tmp_path / "two"
    sensor = yaml.safe_load((one / "SENSOR.yaml").read_text())
    assert set(sensor) == {"skin_radius_mm", "camera_distance_mm", "visible_half_angle_deg", "polarity"}
    assert sensor["polarity"] == "bright"
    rows = table(one / "PRESSES.csv")
    assert list(rows[0]) == ["image", "indenter", "radius_mm", "depth_mm", "x_mm", "y_mm"]
    assert {row["indenter"] for row in rows} == {"ball"}
    names = sorted(path.name for path in one.iterdir())
    assert len(names) == 8 + 3 + 2
    for name in names:
        assert (one / name).read_bytes() == (two / name).read_bytes()
    first, second = (cv2.imread(str(one / f"reference_0{k}.png")).astype(int) for k in (0, 1))
    assert 0 < np.abs(first - second).mean() < 10  # the same scene with other noise


def test_calibration_set_of_the_sensor_that_the_daemon_simulates_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = tmp_path / "my practice"
    assert main(["simulate", "--calibration-set", str(made), "--presses", "9"]) == 0
    calibrate, run = (shlex.split(line) for line in capsys.readouterr().out.splitlines()[-2:])
    references = sorted(str(path) for path in made.glob("reference_*.png"))
    at = calibrate.index(f"{made}/reference_*.png")  # a shell's work
    assert main([*calibrate[1:at], *references, *calibrate[at + 1 :]]) == 0
    assert run[:-1] == ["tacshade-edge", "run", "--config"]
    settings = load(Path(run[-1])).settings
    assert settings.calibration == calibrate[-1]
    assert Path(settings.calibration).exists()
    assert settings.source == Simulated()
    assert settings.recorder.folder == str(made / "recordings")


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--out", "OUT", "--objects", "teapot"], 78, "found 'teapot'"),
        (["--out", "OUT", "--objects", "ball", "--position", "30", "0"], 78, "not over the skin"),
        (["--out", "OUT", "--objects", "ball", "--depth", "19.5"], 78, "reaches the sensor's centre"),
        (["--out", "FILE/x", "--objects", "none"], 1, "cannot write it"),
        (["--calibration-set", "FILE"], 1, "cannot write it"),
        (["--pad", "OUT", "--pad-step", "0"], 78, "found a step of 0 mm and a depth of 2.7 mm, expected a step of 0.5"),
        (["--pad", "OUT", "--pad-depth", "5"], 78, "a depth above 0 and up to 3 mm"),
        (["--pad", "FILE"], 1, "cannot write it"),
    ],
)
def test_what_cannot_be_is_one_line(
    words: list[str], code: int, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "FILE").write_text("a file in the way")
    places = {"OUT": str(tmp_path / "out"), "FILE": str(tmp_path / "FILE"), "FILE/x": str(tmp_path / "FILE" / "x")}
    assert main(["simulate", *(places.get(word, word) for word in words)]) == code
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert message in error


@pytest.mark.parametrize("words", [[], ["--out", "x", "--depth", "nan"], ["--out", "x", "--seed", "-1"]])
def test_usage_mistakes_exit_2(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["simulate", *words])
    assert exit_.value.code == 2
    assert "Traceback" not in capsys.readouterr().err
