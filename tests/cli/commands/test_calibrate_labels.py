"""`calibrate --labels` on simulated presses, as a person calls it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.calibrated_sensor import simulated
from support.sensor_files import write_files

from tacshade_edge.cli import main
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.images import read_image
from tacshade_edge.types import Calibration, Frame, Need

pytestmark = pytest.mark.slow
ROWS = 60


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Cylinders of known depth and tilt, and one frame of the free skin."""
    folder = tmp_path_factory.mktemp("labelled")
    random = np.random.default_rng(3)
    lines = ["image,depth_mm,tilt_x_deg,force_z_n"]
    for k in range(ROWS):
        depth_mm, tilt_x_deg = random.uniform(1.4, 3.0), random.uniform(-15, 15)
        press = Press(OBJECTS["cylinder"](), 0.0, 0.0, depth_mm, tilt_x_deg=tilt_x_deg)
        cv2.imwrite(str(folder / f"{k}.png"), simulated().frame((press,), k).image)
        force = f"{-1.3 * depth_mm:.4f}" if k < 30 else ""
        lines.append(f"{k}.png,{depth_mm:.4f},{tilt_x_deg:.4f},{force}")
    cv2.imwrite(str(folder / "free.png"), simulated().frame((), 5).image)
    (folder / "LABELS.csv").write_text("\n".join([*lines, "free.png,0,,"]) + "\n")
    return folder


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """SENSOR.yaml and references, without presses."""
    given = write_files(tmp_path_factory.mktemp("sensor"))
    return [*given[:2], *given[4:]]


def one_line(text: str) -> str:
    assert text.count("\n") == 1
    assert "Traceback" not in text
    return text


def test_it_learns_and_reports(
    words: list[str], folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "cal.npz"
    labels = ["--labels", str(folder / "LABELS.csv")]
    assert main(["calibrate", *words, *labels, "--out", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report["touch"]) == {"fast", "balanced", "accurate"}
    for one in report["touch"].values():
        assert one["frames"] == ROWS
        assert one["left_out"] == [f"{folder}/LABELS.csv:{ROWS + 2}: found no contact"]
        assert one["quantities"]["depth_mm"]["error"] < 0.2
        assert one["quantities"]["tilt_x_deg"]["error"] < 3.0
        assert "force_z_n" not in one["quantities"]  # 30 rows are too few
    assert any(
        "force_z_n: found 30 usable rows in 30 groups, expected at least 40 rows in 5 groups" in line
        for line in report["warnings"]
    )
    calibration = calibration_file.load(out)
    answers(calibration, folder)
    others(calibration, folder)


def answers(calibration: Calibration, folder: Path) -> None:
    reconstructor = make_reconstructor(calibration, PROFILES["balanced"])
    lines = (folder / "LABELS.csv").read_text().splitlines()[1:6]
    for line in lines:
        name, depth_mm, tilt_x_deg, _ = line.split(",")
        made = reconstructor.step(Frame(0, 0, 0, read_image(folder / name)))
        assert made is not None
        assert made.touch is not None
        assert made.touch.values["depth_mm"] == pytest.approx(float(depth_mm), abs=0.4)
        assert made.touch.values["tilt_x_deg"] == pytest.approx(float(tilt_x_deg), abs=5)
    unasked = reconstructor.step(Frame(0, 0, 0, read_image(folder / "0.png")), need=Need.SHEAR | Need.SIGMA)
    assert unasked is not None
    assert unasked.touch is None
    free = reconstructor.step(Frame(0, 0, 0, read_image(folder / "free.png")))
    assert free is not None
    assert free.touch is None
    assert np.array_equal(made.height.height_mm, step_without_touch(calibration, folder / name), equal_nan=True)


def step_without_touch(calibration: Calibration, path: Path) -> np.ndarray:
    made = make_reconstructor(replace(calibration, touch={}), PROFILES["balanced"]).step(
        Frame(0, 0, 0, read_image(path)), need=Need.DEPTH
    )
    assert made is not None
    return made.height.height_mm


def others(calibration: Calibration, folder: Path) -> None:
    """Learnt with other networks: no number, and the command that helps."""
    model = replace(calibration.touch["fast"], networks="0" * 64)
    reconstructor = make_reconstructor(replace(calibration, touch={"fast": model}), PROFILES["fast"])
    made = reconstructor.step(Frame(0, 0, 0, read_image(folder / "0.png")))
    assert made is not None
    assert made.touch is not None
    assert made.touch.values == {}
    assert made.touch.reason is not None
    assert made.touch.reason.code is ReasonCode.TOUCH_NETWORKS
    assert "calibrate --labels" in made.touch.reason.text


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "image,depth_mm\n0.png,1\n",
            "LABELS.csv: found 1 rows with depth_mm, expected at least 40 rows with the same quantity",
        ),
        ("image,depth_mm\n" + 40 * "gone.png,1\n", "LABELS.csv:2: image: "),
        ("image,depth_mm\n" + 40 * "small.png,1\n", "small.png: found 32x24 px, expected 320x240 px"),
        ("image,depth_mm\n" + 40 * "free.png,1\n", "cannot learn any quantity: fast: left out 40 labelled frames: "),
        (
            "image,depth_mm,group\n" + "".join(f"{k}.png,{k},1\n" for k in range(45)),
            "depth_mm: found 45 usable rows in 1 groups, expected at least 40 rows in 5 groups; left out",
        ),
        ("image,colour\n0.png,1\n", "LABELS.csv:1: colour: found an unknown column, expected image, group and any of"),
    ],
)
def test_a_mistake_is_one_line(
    words: list[str], folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((24, 32), np.uint8))
    for path in folder.glob("*.png"):
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "LABELS.csv").write_text(text)
    out = tmp_path / "cal.npz"
    assert main(["calibrate", *words, "--labels", str(tmp_path / "LABELS.csv"), "--out", str(out)]) == 78
    assert said in one_line(capsys.readouterr().err)
    assert not out.exists()


def test_a_new_reference_keeps_it(
    words: list[str], folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, renewed, few = tmp_path / "cal.npz", tmp_path / "new.npz", folder / "FEW.csv"
    lines = (folder / "LABELS.csv").read_text().splitlines()[:41]
    few.write_text("".join(",".join(line.split(",")[:2]) + "\n" for line in lines))
    assert main(["calibrate", *words, "--labels", str(few), "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert "touch model of balanced: 40 frames" in said.out
    assert "depth_mm: off by" in said.out
    references = words[words.index("--reference") + 1 :]
    assert main(["calibrate", "--rezero", str(out), "--reference", *references, "--out", str(renewed)]) == 0
    touch = calibration_file.load(renewed).touch
    assert touch["fast"].networks == calibration_file.load(out).touch["fast"].networks
    with pytest.raises(SystemExit, match="2"):
        main(["calibrate", "--rezero", str(out), "--reference", *references, "--labels", "x", "--out", str(renewed)])
