"""`calibrate` from references and presses, and a new reference."""

from __future__ import annotations

import csv
import importlib
import inspect
import json
import re
import sys
from pathlib import Path
from types import FrameType

import cv2
import numpy as np
import pytest

import tacshade_edge
from support.calibrated_sensor import calibrated, pressed, unloaded
from support.sensor_files import refused, rows_of, with_table
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.calibration.indenters import Ball
from tacshade_edge.cli import main
from tacshade_edge.files.images import read_image
from tacshade_edge.lab.simulator import camera_faults

pytestmark = pytest.mark.slow


def test_what_was_fitted_is_printed_and_stored(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "cal.npz"
    command = [*with_table(words, tmp_path / "few.csv", rows_of(words)[:11]), "--out", str(out)]
    assert main(["calibrate", *command]) == 0
    printed = capsys.readouterr().out
    calibration = calibration_file.load(out)
    for key in (
        "radius_px",
        "pitch_px",
        "mm_per_px",
        "accurate_depth_mae_mm",
        "fast_depth_worst_mm",
    ):
        assert f"  {key}: " in printed
    assert re.search(r"^(fair|poor): depth is within \d\.\d\d mm", printed, re.MULTILINE)
    assert "  to do: 10 presses: 20 to 40" in printed
    assert re.search(
        r"^  with balanced, the profile of `run`, its dashboard and `reconstruct` by default: \d.*"
        r" mm at worst of these \d+; others may be further off$",
        printed,
        re.MULTILINE,
    )
    assert main(["calibrate", *command, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["crc32"] == f"{calibration.crc32:08x}"
    assert report["crc32"] in printed
    figures = calibration_file.fit_figures(calibration.fit)
    assert {
        "presses",
        "agreement_mae_mm",
        "position_mae_mm",
        "fast_presses",
        "accurate_depth_worst_mm",
    } <= set(figures)
    assert {key: report[key] for key in figures} == pytest.approx(figures, abs=1e-4)
    assert report["verdict_line"].startswith(report["verdict"])
    assert report["to_do"][0].startswith("10 presses")


def test_it_runs_few_files(words: list[str], tmp_path: Path) -> None:
    """Of the package, so that one can read how a calibration is made."""
    package, files = str(Path(tacshade_edge.__file__).parent), set()
    # What runs only as a module is imported is not of a calibration.
    importlib.import_module("tacshade_edge.settings")

    def see(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if (
            event == "call"
            and code.co_flags & inspect.CO_OPTIMIZED
            and code.co_filename.startswith(package)
        ):
            files.add(code.co_filename)

    sys.setprofile(see)
    try:
        assert main(["calibrate", *words, "--out", str(tmp_path / "cal.npz")]) == 0
    finally:
        sys.setprofile(None)
    print(f"figure: calibrate runs functions of {len(files)} files")
    assert len(files) <= 59, sorted(files)


def test_a_folder_of_references_and_a_picture_of_what_was_found(
    alone: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given, plot, out = tmp_path / "free", tmp_path / "seen.png", tmp_path / "cal.npz"
    given.mkdir()
    references = alone[alone.index("--reference") + 1 :]
    for path in references:
        (given / Path(path).name).symlink_to(path)
    command = [
        "calibrate",
        *alone[: -len(references)],
        str(given),
        "--out",
        str(out),
        "--plot",
        str(plot),
    ]
    assert main(command) == 0
    assert read_image(plot).std() > 10
    (given / "flat.png").write_bytes(
        cv2.imencode(".png", np.full((240, 320), 90, np.uint8))[1].tobytes()
    )
    plot.unlink()
    out.unlink()
    capsys.readouterr()
    command[command.index(str(given))] = str(given / "flat.png")
    refused(command, capsys)
    assert read_image(plot).shape[0] > 240


def test_depths_as_travel_from_first_touch_are_refused_unless_said_so(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header, *rows = rows_of(words)
    travels = []
    for image, indenter, radius, depth, x, y in rows:
        travel_mm = float(depth) - Ball(float(x), float(y), 0.0, float(radius)).first_touch_mm(20.0)
        if travel_mm > 0:
            travels.append([image, indenter, radius, str(travel_mm), x, y])
    command = ["calibrate", *with_table(words, tmp_path / "travel.csv", [header, *travels])]
    command += ["--out", str(tmp_path / "cal.npz")]
    assert "pass --depth-from-touch" in refused(command, capsys)
    assert main([*command, "--depth-from-touch"]) == 0
    assert "travel" not in capsys.readouterr().err


def test_a_loaded_reference_needs_a_flag_and_is_named(
    alone: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = tmp_path / "loaded.png"
    cv2.imwrite(str(image), pressed("cube", 3.0).image)
    command = ["calibrate", *alone, str(image), "--out", str(tmp_path / "cal.npz")]
    assert f"seems pressed in reference {image}" in refused(command, capsys)
    assert main([*command, "--allow-loaded-reference"]) == 0
    assert "seems pressed" in capsys.readouterr().err


def test_bad_input_is_one_line(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "text.png").write_text("no image")
    (tmp_path / "cut.png").write_bytes(Path(words[5]).read_bytes()[:1000])
    cv2.imwrite(str(tmp_path / "large.png"), np.zeros((480, 640), np.uint8))
    header = "image,indenter,radius_mm,depth_mm,x_mm,y_mm\n"
    (tmp_path / "few.csv").write_text(header)
    (tmp_path / "bad.csv").write_text(header + "cut.png,ball,4.5,2,,\n")
    (tmp_path / "unknown.yaml").write_text(Path(words[1]).read_text() + "colour: red\n")
    (tmp_path / "type.yaml").write_text(Path(words[1]).read_text().replace("20.0", "twenty"))
    out, sensor = str(tmp_path / "cal.npz"), words[:2]
    cases = {
        "unknown.yaml:5: colour": ["--sensor", str(tmp_path / "unknown.yaml"), *words[4:]],
        "type.yaml:3: skin_radius_mm": ["--sensor", str(tmp_path / "type.yaml"), *words[4:]],
        "text.png": [*sensor, "--reference", str(tmp_path / "text.png")],
        "large.png: found 640x480 px": [*sensor, *words[4:], str(tmp_path / "large.png")],
        "few.csv": [*sensor, "--presses", str(tmp_path / "few.csv"), *words[4:]],
        "bad.csv:2: image: ": [*sensor, "--presses", str(tmp_path / "bad.csv"), *words[4:]],
    }
    for said, given in cases.items():
        assert said in refused(["calibrate", *given, "--out", out], capsys)
    nowhere = str(tmp_path / "none" / "cal.npz")
    assert nowhere in refused(["calibrate", *sensor, *words[4:], "--out", nowhere], capsys, 1)


def test_named_indenters(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Other shapes are in tests/calibration/test_indenters.py."""
    header, *rows = rows_of(words)
    names = {row[2]: f"ball-{k}" for k, row in enumerate(rows[:12])}
    indenters = [
        f"{name}: {{shape: ball, radius_mm: {radius}}}\n" for radius, name in names.items()
    ]
    (tmp_path / "INDENTERS.yaml").write_text("".join(indenters))
    table, folder = tmp_path / "PRESSES.csv", Path(words[3]).parent
    with table.open("w", newline="") as stream:
        named = [
            ["3", str(folder / image), names[radius], "", *numbers]
            for image, _, radius, *numbers in rows[:12]
        ]
        csv.writer(stream).writerows([["force", *header], *named])
    command = [
        "calibrate",
        *words[:2],
        "--presses",
        str(table),
        *words[4:],
        "--out",
        str(tmp_path / "cal.npz"),
    ]
    assert main(command) == 78
    assert "PRESSES.csv:2: indenter: found 'ball-" in capsys.readouterr().err
    assert main([*command, "--indenters", str(tmp_path / "INDENTERS.yaml")]) == 0
    assert f"warning: {table}: ignoring unknown columns: force\n" in capsys.readouterr().err
    fit = calibration_file.load(tmp_path / "cal.npz").fit
    assert fit is not None
    assert fit.presses == 12


def test_rezero_keeps_all_but_the_reference(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new, dim = tmp_path / "old.npz", tmp_path / "new.npz", []
    calibration_file.save(old, calibrated())
    for k in range(3):
        dim.append(str(tmp_path / f"dim{k}.png"))
        cv2.imwrite(dim[-1], camera_faults.gain(unloaded(noise_seed=70 + k), 0.7))
    assert (
        main(["calibrate", "--rezero", str(old), "--reference", *dim, "--out", str(new), "--json"])
        == 0
    )
    report = json.loads(capsys.readouterr().out)
    assert report["light"] == pytest.approx(0.7, abs=0.02)
    (warning,) = report["warnings"]
    assert warning.endswith(f"times the light since {old}")
    before, after = calibration_file.load(old), calibration_file.load(new)
    assert report["crc32"] == f"{after.crc32:08x}" != f"{before.crc32:08x}"
    assert (after.geometry, after.fit, after.alpha) == (before.geometry, before.fit, before.alpha)
    assert after.factors == before.factors
    assert after.reference_grey.mean() < 0.8 * before.reference_grey.mean()


def test_rezero_refuses_in_one_line(
    alone: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old, out = tmp_path / "old.npz", tmp_path / "new.npz"
    calibration_file.save(old, calibrated())
    images = {
        "the camera has moved by 5.0 px": camera_faults.shift(unloaded(), 0, 5),
        "seems pressed": pressed("cube", 3.0).image,
    }
    for said, image in images.items():
        cv2.imwrite(str(tmp_path / "image.png"), image)
        command = [
            "calibrate",
            "--rezero",
            str(old),
            "--reference",
            str(tmp_path / "image.png"),
            "--out",
            str(out),
        ]
        line = refused(command, capsys)
        assert f"{old}: rejected " in line
        assert said in line
    more = (alone[:2], ["--presses", "x"], ["--fit"])
    for wrong in (*(["--rezero", str(old), *words] for words in more), []):
        with pytest.raises(SystemExit, match="2"):
            main(
                ["calibrate", *wrong, "--reference", str(tmp_path / "image.png"), "--out", str(out)]
            )
        assert "--rezero" in capsys.readouterr().err
