from __future__ import annotations

import csv
import inspect
import json
import re
import sys
from pathlib import Path
from types import FrameType

import cv2
import numpy as np
import pytest
from support.calibrated_sensor import calibrated, pressed, simulated, unloaded
from support.networks import fitted_with
from support.sensor_files import write_files

import tacshade_edge
from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.calibration.indenters import Ball
from tacshade_edge.cli import main
from tacshade_edge.files.images import read_image
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.types import U8

pytestmark = pytest.mark.slow
LABELLED = 60


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return write_files(tmp_path_factory.mktemp("sensor"))


@pytest.fixture(scope="module")
def alone(words: list[str]) -> list[str]:
    """SENSOR.yaml and references, without presses."""
    return [*words[:2], *words[4:]]


def with_table(words: list[str], path: Path, rows: list[list[str]]) -> list[str]:
    """The words of `calibrate` with another table,
    whose first column names images of the first one.
    """
    folder = Path(words[3]).parent
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(
            [rows[0], *([str(folder / row[0]), *row[1:]] for row in rows[1:])]
        )
    return [*words[:3], str(path), *words[4:]]


def rows_of(words: list[str]) -> list[list[str]]:
    return [line.split(",") for line in Path(words[3]).read_text().splitlines()]


def refused(command: list[str], capsys: pytest.CaptureFixture[str], code: int = 78) -> str:
    """The one line of a command that makes no file."""
    assert main(command) == code
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    assert text.startswith("tacshade-edge: ")
    assert not Path(command[command.index("--out") + 1]).exists()
    return text


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
        r"^  with balanced, the profile of `run` and `reconstruct` by default: \d",
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
    assert len(files) <= 56, sorted(files)


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
        (["--rest", "none"], r"none: "),
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
    assert re.search(message, refused(["calibrate", *words], capsys))


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
            "cannot learn any quantity: fast: depth_mm: found 40 usable rows in 40 groups",
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
