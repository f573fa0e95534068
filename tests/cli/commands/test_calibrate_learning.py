"""`calibrate` learns from rest, fits to touches, and from labels."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.calibrated_sensor import calibrated, simulated
from support.csv_rows import csv_rows
from support.networks import fitted_with
from support.sensor_files import refused, rows_of, with_table
from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import main
from tacshade_edge.files.images import read_image
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.types import U8

pytestmark = pytest.mark.slow
LABELLED = 60


@pytest.fixture(scope="module")
def resting(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the untouched sensor."""
    folder = tmp_path_factory.mktemp("rest")
    for k in range(10):
        cv2.imwrite(str(folder / f"rest_{k}.png"), simulated().frame((), 500 + k).image)
    return folder


def test_the_untouched_sensor_shows_where_a_touch_begins(
    alone: list[str], resting: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, renewed = tmp_path / "cal.npz", tmp_path / "renewed.npz"
    command = ["calibrate", *alone, "--out", str(out), "--rest", str(resting)]
    assert main(command) == 0
    said_in_words = capsys.readouterr().out
    assert "one untouched frame in 10,000 is taken for a touch" in said_in_words
    assert re.search(r"balanced reports a touch from 0\.\d\d mm of its own", said_in_words)
    assert "it finds" not in said_in_words
    assert main([*command, "--false-contacts", "0.01", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["rest"]
    limits = calibration_file.load(out).rest
    assert said.keys() == limits.keys() == {"fast", "balanced", "accurate"}
    for name, limit in limits.items():
        assert (limit.frames, limit.false_contacts) == (10 + 5, 0.01)
        assert said[name]["height_mm"] == pytest.approx(limit.height_mm, abs=1e-4)
        assert 0 < limit.height_mm < 0.1
        assert 0 < limit.local_change < 0.05
    rezero = ["calibrate", "--rezero", str(out), *alone[2:], "--out", str(renewed)]
    assert main(rezero) == 0
    assert calibration_file.load(renewed).rest == limits
    assert main([*rezero, "--rest", str(resting)]) == 0
    assert calibration_file.load(renewed).rest["fast"].false_contacts == 1e-4


def test_presses_show_what_is_found(
    words: list[str], resting: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = with_table(words, tmp_path / "few.csv", rows_of(words)[:11])
    assert (
        main(["calibrate", *table, "--rest", str(resting), "--out", str(tmp_path / "c.npz")]) == 0
    )
    found = re.search(
        r"it finds 10 of 10 presses \(the shallowest one of (.*) mm\)", capsys.readouterr().out
    )
    assert found is not None
    assert 0 < float(found[1]) < 2


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--rest", "none"], r"--rest: .*none: found nothing"),
        (["--rest", "few"], r"--rest: .*few: found 2 usable images .*, expected at least 8"),
        (["--rest", "small"], r"--rest: .*small: found 0 usable images"),
    ],
)
def test_a_rest_that_shows_nothing_is_refused(
    alone: list[str],
    resting: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    more: list[str],
    message: str,
) -> None:
    for name, count in (("few", 2), ("small", 9)):
        (tmp_path / name).mkdir()
        for path in sorted(resting.iterdir())[:count]:
            image = read_image(path)
            cv2.imwrite(str(tmp_path / name / path.name), image if count == 2 else image[::2])
    words = [*alone[:4], "--out", str(tmp_path / "cal.npz"), more[0], str(tmp_path / more[1])]
    line = refused(["calibrate", *words], capsys)
    assert re.search(message, line)
    assert line.count(str(tmp_path / more[1])) == 1


@pytest.mark.parametrize(
    "more", [["--false-contacts", "0.1"], ["--rest", "x", "--false-contacts", "2"]]
)
def test_a_rate_needs_a_rest_and_bounds(
    alone: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["calibrate", *alone, "--out", str(tmp_path / "cal.npz"), *more])
    assert stopped.value.code == 2
    assert "--false-contacts" in capsys.readouterr().err


@pytest.mark.parametrize("layout", [None, "another"])
def test_a_new_reference_keeps_the_fit(
    alone: list[str], tmp_path: Path, layout: str | None
) -> None:
    old, new = tmp_path / "old.npz", tmp_path / "new.npz"
    calibration_file.save(old, fitted_with("fast", calibrated(), layout=layout))
    assert main(["calibrate", "--rezero", str(old), *alone[2:], "--out", str(new)]) == 0
    assert set(loading.load(new).fitted) == (set() if layout else {"fast"})
    assert loading.fits_to_renew(new) == (("fast",) if layout else ())


def test_a_fit_without_its_extra_names_it(
    words: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda module: None if module == "numba" else True
    )
    line = refused(["calibrate", *words, "--fit", "--out", str(tmp_path / "cal.npz")], capsys)
    assert (
        "--fit: the package numba is not installed; to install it: pip install torch --index-url "
        in line
    )
    assert "/whl/cpu, then pip install '.[fit]' in the clone" in line


@pytest.mark.fit
def test_a_fit_goes_into_the_file(
    words: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The fit itself is in tests/fitting."""
    pytest.importorskip("torch", reason="PyTorch (the extra fit) is not installed")
    from tacshade_edge.lab.fitting import fit

    made = fit.FitResult(
        fitted_with("fast", calibrated()),
        ("found a print",),
        (fit.NetworkReport("fast", 0.3, 0.2),),
    )
    given: list[U8] = []

    def fitted(*_: object, touches: list[U8]) -> fit.FitResult:
        given.extend(touches)
        return made

    monkeypatch.setattr(fit, "fit", fitted)
    out, touches = tmp_path / "cal.npz", tmp_path / "touches"
    touches.mkdir()
    cv2.imwrite(str(touches / "1.png"), simulated().frame((), 5).image)
    command = ["calibrate", *words, "--fit", "--touches", str(touches), "--out", str(out)]
    assert main([*command, "--json"]) == 0
    assert len(given) == 1
    report = json.loads(capsys.readouterr().out)
    assert (list(report["fitted"]), report["fit_found"]) == (["fast"], ["found a print"])
    assert set(calibration_file.load(out).fitted) == {"fast"}


def test_a_refused_fit_writes_the_calibration_and_exits_1(
    words: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("torch", reason="PyTorch (the extra fit) is not installed")
    from tacshade_edge.lab.fitting import fit

    made = fit.FitResult(calibrated(), ("nothing is fitted",), advice=("take touches",))
    monkeypatch.setattr(fit, "fit", lambda *_, **__: made)
    out = tmp_path / "cal.npz"
    assert main(["calibrate", *words, "--fit", "--out", str(out)]) == 1
    printed = capsys.readouterr()
    assert "nothing is fitted" in printed.err
    assert "to do: take touches" in printed.out
    assert not calibration_file.load(out).fitted


@pytest.mark.parametrize(
    "form",
    [
        "skin: pad\nvisible_radius_mm: 15",
        "skin_radius_mm: 200\nvisible_half_angle_deg: 8",
    ],
)
def test_a_flat_skin_is_not_fitted(
    words: list[str], form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flat = tmp_path / "SENSOR.yaml"
    flat.write_text(f"{form}\ncamera_distance_mm: 30\n")
    given = [str(flat) if word.endswith("SENSOR.yaml") else word for word in words]
    assert main(["calibrate", *given, "--fit", "--out", str(tmp_path / "cal.npz")]) == 78
    assert "a fit simulates no twin of a flat skin" in capsys.readouterr().err


def test_touches_of_another_size_are_refused(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch", reason="PyTorch (the extra fit) is not installed")
    cv2.imwrite(str(tmp_path / "touch.png"), np.zeros((24, 32), np.uint8))
    command = ["calibrate", *words, "--touches", str(tmp_path / "touch.png")]
    assert main([*command, "--fit", "--out", str(tmp_path / "cal.npz")]) == 78
    assert "touch.png: found 32x24 px, expected 320x240 px" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*command, "--out", str(tmp_path / "cal.npz")])
    assert "--touches has no effect without --fit" in capsys.readouterr().err


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Cylinders of known depth and tilt, and one frame of the free skin."""
    folder = tmp_path_factory.mktemp("labelled")
    random = np.random.default_rng(3)
    lines = ["image,depth_mm,tilt_x_deg,force_z_n"]
    for k in range(LABELLED):
        depth_mm, tilt_x_deg = random.uniform(1.4, 3.0), random.uniform(-15, 15)
        press = Press(OBJECTS["cylinder"](), 0.0, 0.0, depth_mm, tilt_x_deg=tilt_x_deg)
        cv2.imwrite(str(folder / f"{k}.png"), simulated().frame((press,), k).image)
        force = f"{-1.3 * depth_mm:.4f}" if k < 30 else ""
        lines.append(f"{k}.png,{depth_mm:.4f},{tilt_x_deg:.4f},{force}")
    cv2.imwrite(str(folder / "free.png"), simulated().frame((), 5).image)
    cv2.imwrite(str(folder / "small.png"), np.zeros((24, 32), np.uint8))
    (folder / "LABELS.csv").write_text("\n".join([*lines, "free.png,0,,"]) + "\n")
    return folder


def test_labels_are_learnt_and_a_new_reference_keeps_them(
    alone: list[str], labelled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, renewed = tmp_path / "cal.npz", tmp_path / "new.npz"
    assert (
        main(
            ["calibrate", *alone, "--labels", f"{labelled}/LABELS.csv", "--out", str(out), "--json"]
        )
        == 0
    )
    report = json.loads(capsys.readouterr().out)
    assert set(report["touch"]) == {"fast", "balanced", "accurate"}
    for one in report["touch"].values():
        assert (one["frames"], one["left_out"]) == (LABELLED + 1, [])
        assert one["quantities"]["depth_mm"]["error"] < 0.2
        assert one["quantities"]["tilt_x_deg"]["error"] < 3.0
        assert "force_z_n" not in one["quantities"]  # 30 rows are too few
    assert any(
        "force_z_n: found 30 usable rows in 30 groups" in line for line in report["warnings"]
    )
    calibration = calibration_file.load(out)
    assert main(["calibrate", "--rezero", str(out), *alone[2:], "--out", str(renewed)]) == 0
    assert (
        calibration_file.load(renewed).touch["fast"].networks == calibration.touch["fast"].networks
    )
    scored_by_what_was_learnt(out, labelled, tmp_path / "scored", capsys)


def scored_by_what_was_learnt(
    calibration: Path, labelled: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`evaluate --labels` compares each label with the model, or says that it does not."""
    capsys.readouterr()
    given = ["--calibration", str(calibration), "--images", str(labelled)]
    given += ["--labels", f"{labelled}/LABELS.csv", "--profile", "balanced", "--out", str(out)]
    assert main(["evaluate", *given, "--json"]) == 0
    printed = capsys.readouterr()
    by_name = {one["quantity"]: one for one in json.loads(printed.out)["touch"]["balanced"]}
    assert list(by_name) == ["depth_mm", "tilt_x_deg"]
    # The free skin has a depth but no tilt.
    for name, frames, most in (
        ("depth_mm", LABELLED + 1, 0.15),
        ("tilt_x_deg", LABELLED, 2.0),
    ):
        assert by_name[name]["frames"] == frames
        assert by_name[name]["error"] < most
        assert by_name[name]["rank_correlation"] > 0.9
    assert "force_z_n: not scored: the calibration's balanced has not learnt it" in printed.err
    rows = csv_rows(out / "labels-touch.csv")
    assert len(rows) == 2 * LABELLED + 1
    assert list(rows[0]) == ["image", "profile", "quantity", "label", "touch", "sigma"]
    assert "| balanced | depth_mm" in (out / "labels.md").read_text().replace("  ", "")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "image,depth_mm\n0.png,1\n",
            "found 1 row with depth_mm, expected at least 40 rows with the same quantity",
        ),
        ("image,depth_mm\n" + 40 * "gone.png,1\n", "LABELS.csv:2: image: "),
        (
            "image,depth_mm\n" + 40 * "small.png,1\n",
            "small.png: found 32x24 px, expected 320x240 px",
        ),
        (
            "image,depth_mm\n" + 40 * "free.png,1\n",
            "cannot learn any quantity: depth_mm: found 1 in all 40 rows that have it, expected",
        ),
    ],
)
def test_a_mistake_in_labels_is_one_line(
    alone: list[str],
    labelled: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    text: str,
    said: str,
) -> None:
    for path in labelled.glob("*.png"):
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "LABELS.csv").write_text(text)
    command = [
        "calibrate",
        *alone,
        "--labels",
        str(tmp_path / "LABELS.csv"),
        "--out",
        str(tmp_path / "cal.npz"),
    ]
    assert said in refused(command, capsys)


def test_labels_in_another_unit_are_refused(
    alone: list[str], labelled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    head, *rows = (labelled / "LABELS.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows if not row.startswith("free")]
    for path in labelled.glob("*.png"):
        (tmp_path / path.name).symlink_to(path)
    table = tmp_path / "LABELS.csv"
    radians = [[a, b, f"{np.radians(float(c)):.6f}", d] for a, b, c, d in cells]
    metres = [[a, f"{float(b) / 1000:.7f}", c, d] for a, b, c, d in cells]
    shifted = [[a, *b] for (a, *_), (_, *b) in zip(cells[1:], cells[:-1], strict=True)]
    for changed, said in (
        (radians, "are they in radians?"),
        (metres, "are they in m?"),
        (shifted, "does each image have the values of the row before?"),
    ):
        table.write_text("\n".join([head, *map(",".join, changed)]) + "\n")
        command = ["calibrate", *alone, "--labels", str(table), "--out", str(tmp_path / "cal.npz")]
        line = refused(command, capsys)
        assert f"{table}: " in line
        assert said in line
