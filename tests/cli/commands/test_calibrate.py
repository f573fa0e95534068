from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.calibrated_sensor import calibrated, pressed, presses, simulated, unloaded
from support.fitted import fitted_with
from support.sensor_files import write_files

from tacshade_edge.cli import main
from tacshade_edge.core.calibration.observation.touches import first_touch_mm
from tacshade_edge.factories import calibrations
from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator.objects import Shape, ridge
from tacshade_edge.simulator.press import Press
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.types import F64
from tools.testbed.patience import patience

pytestmark = pytest.mark.slow


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
    for key in ("radius_px", "pitch_px", "mm_per_px", "accurate_depth_mae_mm", "fast_depth_worst_mm"):
        assert f"  {key}: " in printed.out
    assert calibration.fit is not None
    assert calibration.fit.presses > 15


def test_json_is_what_was_stored(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "cal.npz"
    assert main(["calibrate", *words, "--out", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    calibration = calibration_file.load(out)
    assert report["crc32"] == f"{calibration.crc32:08x}"
    assert report["pitch_px"] == pytest.approx(calibration.pitch_px, abs=1e-3)
    figures = calibration_file.fit_figures(calibration.fit)
    assert {"presses", "agreement_mae_mm", "position_mae_mm", "fast_presses", "accurate_depth_worst_mm"} <= set(figures)
    assert {key: report[key] for key in figures} == pytest.approx(figures, abs=1e-4)
    assert isinstance(report["warnings"], list)


def test_without_presses_it_says_what_is_missing(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = [*words[:2], *words[4:6]]  # one reference
    assert main(["calibrate", *alone, "--out", str(tmp_path / "cal.npz")]) == 0
    printed = capsys.readouterr()
    assert "uncalibrated: depth assumes an average sensor of this kind" in printed.out
    assert printed.err.startswith("warning: references: found 1, expected 5 to measure noise")


def test_depths_as_travel_from_first_touch_are_refused_unless_said_so(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, out = Path(words[3]), tmp_path / "cal.npz"
    rows = list(csv.DictReader(table.read_text().splitlines()))
    for row in rows:
        place_mm = float(row["x_mm"]), float(row["y_mm"])
        row["depth_mm"] = str(float(row["depth_mm"]) - first_touch_mm(float(row["radius_mm"]), 20.0, *place_mm))
        row["image"] = str(table.parent / row["image"])
    with (tmp_path / "travel.csv").open("w", newline="") as stream:
        written = csv.DictWriter(stream, rows[0])
        written.writeheader()
        written.writerows(row for row in rows if float(row["depth_mm"]) > 0)
    command = ["calibrate", *words[:2], "--presses", str(tmp_path / "travel.csv"), *words[4:], "--out", str(out)]
    assert main(command) == 78
    assert "travel from first touch" in (line := one_line(capsys.readouterr().err))
    assert "pass --depth-from-touch" in line
    assert not out.exists()
    assert main([*command, "--depth-from-touch"]) == 0
    assert "travel" not in capsys.readouterr().err


def test_a_loaded_reference_needs_a_flag(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = tmp_path / "loaded.png"
    cv2.imwrite(str(image), pressed("cube", 3.0).image)
    command = ["calibrate", *words[:2], "--reference", str(image), "--out", str(tmp_path / "cal.npz")]
    assert main(command) == 78
    assert "seems pressed" in one_line(capsys.readouterr().err)
    assert not (tmp_path / "cal.npz").exists()
    assert main([*command, "--allow-loaded-reference"]) == 0
    assert "seems pressed in the reference" in capsys.readouterr().err


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


def test_named_indenters(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Half of the presses by a flat end and a tilted square, in a spreadsheet's table."""
    folder, shapes = Path(words[3]).parent, {"flat": pillar(4.0), "square": ridge(8.0, 6.0)}
    rows = ["force;image;indenter;radius_mm;depth_mm;x_mm;y_mm;yaw_deg;tilt_x_deg"]
    for k, press in enumerate(presses()[:12]):
        name = ("ball", "flat", "square")[k % 3]
        image, radius, turn = folder / f"press{k}.png", str(press.radius_mm), (0.0, 0.0)
        if name != "ball":
            turn, radius = (20.0, 5.0) if name == "square" else (0.0, 0.0), ""
            at = Press(shapes[name], press.x_mm or 0, press.y_mm or 0, press.depth_mm, turn[0], 1.0, turn[1])
            image = tmp_path / f"{k}.png"
            cv2.imwrite(str(image), simulated().frame((at,), 500 + k).image)
        numbers = ";".join(map(str, (radius, press.depth_mm, press.x_mm, press.y_mm, *turn))).replace(".", ",")
        rows.append(f"3;{image};{name};{numbers}")
    table, indenters = tmp_path / "PRESSES.csv", tmp_path / "INDENTERS.yaml"
    table.write_bytes("\r\n".join(rows).encode("utf-16"))
    indenters.write_text("flat: {shape: cylinder, radius_mm: 4}\nsquare: {shape: box, length_mm: 8, width_mm: 6}\n")
    command = ["calibrate", *words[:2], "--presses", str(table), *words[4:], "--out", str(tmp_path / "cal.npz")]
    assert main([*command, "--indenters", str(indenters)]) == 0
    assert capsys.readouterr().err == f"warning: {table}: ignoring unknown columns: force\n"
    fit = calibration_file.load(tmp_path / "cal.npz").fit
    assert fit is not None
    assert fit.presses == 12
    assert fit.profiles["accurate"].presses == 12
    assert main(command) == 78
    line = one_line(capsys.readouterr().err)
    assert line.endswith("PRESSES.csv:3: indenter: found 'flat', expected ball (other indenters need --indenters)\n")


def pillar(radius_mm: float) -> Shape:
    """A flat end."""

    def sdf(p: F64) -> F64:
        side, foot = np.hypot(p[:, 0], p[:, 1]) - radius_mm, -p[:, 2]
        return np.minimum(np.maximum(side, foot), 0) + np.hypot(np.maximum(side, 0), np.maximum(foot, 0))

    return Shape("pillar", sdf)


def test_the_quality_is_printed(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "PRESSES.csv"
    rows = Path(words[3]).read_text().splitlines()
    folder = Path(words[3]).parent
    few = [rows[0], *(str(folder / row) for row in rows[1:11])]
    table.write_text("\n".join(few) + "\n")
    command = ["calibrate", *words[:2], "--presses", str(table), *words[4:], "--out", str(tmp_path / "cal.npz")]
    assert main(command) == 0
    printed = capsys.readouterr()
    assert re.search(r"^(fair|poor): depth is within \d\.\d\d mm", printed.out, re.MULTILINE)
    assert "  to do: 10 presses: 20 to 40" in printed.out
    assert main([*command, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["verdict"] in ("fair", "poor")
    assert report["verdict_line"].startswith(report["verdict"])
    assert report["to_do"][0].startswith("10 presses")


def test_rezero_keeps_all_but_the_reference(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new = tmp_path / "old.npz", tmp_path / "new.npz"
    assert main(["calibrate", *words, "--out", str(old)]) == 0
    dim = []
    for k in range(3):
        dim.append(str(tmp_path / f"dim{k}.png"))
        cv2.imwrite(dim[-1], nuisance.gain(unloaded(noise_seed=70 + k), 0.7))
    capsys.readouterr()
    assert main(["calibrate", "--rezero", str(old), "--reference", *dim, "--out", str(new), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["light"] == pytest.approx(0.7, abs=0.02)
    (warning,) = report["warnings"]
    assert warning.endswith(f"times the light since {old}")
    before, after = calibration_file.load(old), calibration_file.load(new)
    assert report["crc32"] == f"{after.crc32:08x}" != f"{before.crc32:08x}"
    assert (after.geometry, after.fit, after.alpha) == (before.geometry, before.fit, before.alpha)
    assert after.factors == before.factors
    assert after.reference_grey.mean() < 0.8 * before.reference_grey.mean()


def test_rezero_refuses_in_one_line(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, out = tmp_path / "old.npz", tmp_path / "new.npz"
    calibration_file.save(old, calibrated())
    images = {
        "moved": nuisance.shift(unloaded(), 0, 5),
        "loaded": pressed("cube", 3.0).image,
        "small": unloaded()[:200],
    }
    said = {"moved": "the image moved by 5.0 px", "loaded": "seems pressed", "small": "size: found 320x200 px"}
    for name, image in images.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
        command = ["calibrate", "--rezero", str(old), "--reference", str(tmp_path / f"{name}.png"), "--out", str(out)]
        assert main(command) == 78
        line = one_line(capsys.readouterr().err)
        assert f"{old}: rejected " in line
        assert said[name] in line
        assert not out.exists()
    for wrong in (["--rezero", str(old), *words[:2]], ["--rezero", str(old), *words[2:4]], []):
        with pytest.raises(SystemExit) as usage:
            main(["calibrate", *wrong, "--reference", str(tmp_path / "moved.png"), "--out", str(out)])
        assert usage.value.code == 2
        assert "--rezero" in capsys.readouterr().err


def test_the_process_exits_with_78(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tacshade_edge", "calibrate", "--sensor", "none.yaml", "--reference", "a.png"]
    done = subprocess.run(
        [*command, "--out", "cal.npz"], cwd=tmp_path, capture_output=True, text=True, timeout=patience(60)
    )
    assert done.returncode == 78
    assert done.stdout == ""
    assert "none.yaml" in one_line(done.stderr)


def test_what_is_wrong_with_a_whole_table_names_it(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = Path(words[words.index("--presses") + 1])
    header, *rows = [line.split(",") for line in given.read_text().splitlines()]
    depth = header.index("depth_mm")
    for row in rows:
        row[depth] = str(float(row[depth]) / 1000)
    table = given.with_name("in metres.csv")
    table.write_text("\n".join(",".join(row) for row in [header, *rows]))
    out = tmp_path / "cal.npz"
    assert main(["calibrate", *(str(table) if word == str(given) else word for word in words), "--out", str(out)]) == 78
    line = one_line(capsys.readouterr().err)
    assert line.startswith(f"tacshade-edge: {table}: depth_mm: the images show presses about ")
    assert "are the depths in m? expected mm" in line
    assert not out.exists()


@pytest.mark.parametrize("layout", [None, "another"])
def test_a_new_reference_keeps_the_fit(words: list[str], tmp_path: Path, layout: str | None) -> None:
    old, new = tmp_path / "old.npz", tmp_path / "new.npz"
    calibration_file.save(old, fitted_with("fast", calibrated(), layout=layout))
    assert main(["calibrate", "--rezero", str(old), *words[4:], "--out", str(new)]) == 0
    assert set(calibrations.load(new).fitted) == (set() if layout else {"fast"})
    assert calibrations.fits_to_renew(new) == (("fast",) if layout else ())


@pytest.mark.parametrize(("missing", "name"), [("torch", "PyTorch"), ("numba", "numba")])
def test_a_fit_without_its_extra_names_it(
    words: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    missing: str,
    name: str,
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda module: None if module == missing else True)
    assert main(["calibrate", *words, "--fit", "--out", str(tmp_path / "cal.npz")]) == 78
    assert f"--fit: {name} is not installed; to install it: pip install" in one_line(capsys.readouterr().err)
    assert not (tmp_path / "cal.npz").exists()


def test_a_new_reference_cannot_be_fitted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["calibrate", "--rezero", "x", "--reference", "r.png", "--fit", "--out", str(tmp_path / "cal.npz")])
    assert "--fit has no effect with" in capsys.readouterr().err


@pytest.mark.fit
@pytest.mark.slow
def test_a_fit_goes_into_the_file(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("torch", reason="PyTorch (the extra fit) is not installed")
    from tacshade_edge.fitting import fit

    monkeypatch.setattr(fit, "FULL", fit.Effort(domes=2, held_out=1, skins=2, views=1, steps=2))
    out = tmp_path / "cal.npz"
    assert main(["calibrate", *words, "--fit", "--out", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert list(report["fitted"]) == ["balanced", "accurate", "fast", "shear"]
    kept = {name for name, each in report["fitted"].items() if each["kept"]}
    assert set(calibration_file.load(out).fitted) == kept
    assert "found a print of dark pins" in report["fit_found"][0]
    assert "decays over" in report["fit_found"][1]
    assert [path.name for path in tmp_path.glob("cal.npz*")] == ["cal.npz"]


def test_a_reference_is_named_by_its_file(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    at = words.index("--reference") + 2
    pressed_file, dark = str(tmp_path / "pressed.png"), str(tmp_path / "dark.png")
    cv2.imwrite(pressed_file, pressed("ball", 3.0).image)
    cv2.imwrite(dark, unloaded() * 0)
    given = [*words[:at], pressed_file, *words[at + 1 :]]
    assert main(["calibrate", *given, "--out", str(tmp_path / "cal.npz")]) == 78
    assert f"seems pressed in reference {pressed_file}" in one_line(capsys.readouterr().err)
    assert main(["calibrate", *words, "--out", str(tmp_path / "cal.npz")]) == 0
    capsys.readouterr()
    again = ["calibrate", "--rezero", str(tmp_path / "cal.npz"), "--reference", words[at], dark]
    assert main([*again, "--out", str(tmp_path / "new.npz")]) == 78
    assert f"rejected reference {dark}: black" in one_line(capsys.readouterr().err)
