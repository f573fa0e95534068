"""Every command that works for long looks at all that can make its work worthless first:
what it reads, and whether it can write. Here, the work of each fails the test if it begins.
"""

from __future__ import annotations

import importlib
import os
import shutil
from collections import namedtuple
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from support.painted_sensor import FREE, TOUCHED, painted_calibration
from support.recordings import record_hand, write_recording
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import EXIT_CONFIG, EXIT_FAILED, EXIT_USAGE, main
from tacshade_edge.files.targets import owned_folder

_Usage = namedtuple("_Usage", "total used free")
COMMANDS = "tacshade_edge.cli.commands"
WORK = {
    "calibrate": ("calibrate", "rezero"),
    "capture": ("_sensor", "_camera"),
    "doctor": ("diagnose", "measure_tail"),
    "evaluate": ("evaluate", "score_cases", "reconstructor"),
    "export": ("make_reconstructor", "replay"),
    "recognise": ("touched_images",),
    "reconstruct": ("make_reconstructor",),
    "record": ("MqttCaller",),
    "replay": ("make_reconstructor", "ReplayLink"),
    "simulate": ("SimulatedSensor", "write_pad"),
    "stitch": ("read_presses", "read_recording", "read_contact_frames"),
    "teach": ("touched_images", "_results"),
    "tradeoff": ("workers", "judge", "measure"),
}
CALIBRATE = "calibrate --sensor SENSOR.yaml --reference images --presses PRESSES.csv --out"
FIT = "calibrate --sensor SENSOR.yaml --reference images --fit"
LABELS = "calibrate --sensor SENSOR.yaml --reference images --out new.npz --labels"
PRESSES = "calibrate --sensor SENSOR.yaml --reference images --out new.npz --presses"
REZERO = "calibrate --rezero cal.npz --reference images --out"
IMAGES = "--calibration cal.npz --images images --out"
SIMULATED = "--sensors default --objects ball --out"
STITCH = "stitch --calibration cal.npz --poses POSES.csv --out"
HAND = "export hand/left-thumb hand/left-index"

TO_FILE = [
    CALIBRATE,
    REZERO,
    f"{CALIBRATE} new.npz --plot",
    "doctor --config config.yaml --bundle",
    f"{HAND} --to csv --out",
    "export recording --to csv --out",
    "export recording --to mcap --out",
]
TO_FOLDER = {
    f"evaluate {IMAGES}": "evaluation.csv",
    f"evaluate {SIMULATED}": "evaluation.json",
    "evaluate --labels images/LABELS.csv --calibration cal.npz --images images --out": "labels.md",
    f"tradeoff {IMAGES}": "tradeoff.md",
    f"tradeoff {SIMULATED}": "tradeoff.csv",
    "tradeoff --report --plot --out": "tradeoff.png",
    "simulate --out": "scenes.csv",
    "simulate --calibration-set": "PRESSES.csv",
    "simulate --pad": "PAD.npz",
    "reconstruct images --calibration cal.npz --out": "0.npz",
    "reconstruct images --calibration cal.npz --plot --out": "1.png",
    "replay recording --out": "summary.json",
    STITCH: "map.json",
    "stitch --calibration cal.npz --recording recording --out": "map.npz",
    f"{STITCH[:-6]} --find-flange --out": "flange.json",
    "capture --config config.yaml": "PRESSES.csv",
    "capture --config config.yaml --labels": "LABELS.csv",
}
# What a command reads, and what its line has to name.
BAD_INPUTS = [
    ("calibrate --sensor none.yaml --reference images --out new.npz", "none.yaml"),
    ("calibrate --sensor SENSOR.yaml --reference none.png --out new.npz", "none.png"),
    (f"{PRESSES} none.csv", "none.csv"),
    (f"{PRESSES} missing.csv", "none.png"),
    (f"{PRESSES} PRESSES.csv --indenters none.yaml", "none.yaml"),
    (f"{LABELS} none.csv", "none.csv"),
    (f"{LABELS} images/FEW.csv", "found 2 rows with force_z_n, expected at least"),
    (f"{LABELS} images/LAST_MISSING.csv", "none.png"),
    (f"{LABELS} images/LAST_SMALL.csv", "found 20x20 px"),
    (f"{LABELS[:-9]} --rest none", "none"),
    (f"{LABELS[:-9]} --rest empty", "found no image"),
    (f"{LABELS[:-9]} --rest damaged", "9.png"),
    (f"{FIT} --out new.npz --touches none.png", "none.png"),
    (f"{FIT} --out new.npz --touches damaged", "9.png"),
    (f"{FIT} --out new.npz --labels images/LAST_MISSING.csv", "none.png"),
    ("calibrate --rezero none.npz --reference images --out new.npz", "none.npz"),
    (f"{REZERO} new.npz --rest damaged", "9.png"),
    ("capture new --config none.yaml", "none.yaml"),
    ("capture new --config config.yaml --plan none.csv", "none.csv"),
    ("doctor images --calibration none.npz", "none.npz"),
    ("evaluate --calibration none.npz --images images", "none.npz"),
    ("evaluate --calibration cal.npz --images none", "none"),
    ("evaluate --calibration cal.npz --images images --labels none.csv", "none.csv"),
    ("export none --to csv --calibration cal.npz", "none"),
    ("export recording --to csv --calibration none.npz", "none.npz"),
    ("export images --to csv", "pass --calibration"),
    ("export hand/left-thumb recording --to csv --out new.csv", "expected a recording of a hand"),
    ("recognise images --calibration none.npz", "none.npz"),
    ("recognise images --calibration cal.npz", "found no object"),
    ("reconstruct images --calibration none.npz --out new", "none.npz"),
    ("reconstruct empty --calibration cal.npz --out new", "found no image"),
    ("record --config none.yaml --seconds 1", "none.yaml"),
    ("replay none --out new", "none"),
    ("replay recording --calibration none.npz --out new", "none.npz"),
    ("replay recording --out new --against none", "none/summary.json"),
    ("replay recording --config none.yaml", "none.yaml"),
    ("simulate --calibration-set new --out more --objects teapot", "teapot"),
    ("simulate --calibration-set new --pad more --pad-step 0", "found a step of 0 mm"),
    ("stitch --calibration none.npz --poses POSES.csv --out new", "none.npz"),
    ("stitch --calibration cal.npz --poses none.csv --out new", "none.csv"),
    ("stitch --calibration cal.npz --recording none --out new", "none"),
    (f"{STITCH} new --truth none.npz", "none.npz"),
    ("teach ball none.png --calibration none.npz", "none.npz"),
    ("teach ball --live --config none.yaml", "none.yaml"),
    ("teach ball --live --config objects.yaml", "objects.npz"),
    ("tradeoff --calibration none.npz", "none.npz"),
    ("tradeoff --calibration cal.npz --images none", "none"),
]

# `make check` must pass without the extra: there, these lines end in what to install.
NEEDS_FIT = pytest.mark.skipif(
    not all(map(find_spec, ("torch", "numba"))), reason="the extra fit is not installed"
)


def is_fit(line: str) -> bool:
    """Whether a line of `BAD_INPUTS` needs the extra `fit`."""
    return "--fit" in line or line == "tradeoff --calibration none.npz"


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All that the commands read, each file whole."""
    folder = tmp_path_factory.mktemp("stage")
    calibration_file.save(folder / "cal.npz", painted_calibration())
    calibration_file.save(folder / "taught.npz", painted_calibration())
    (folder / "taught.objects.npz").write_bytes(b"no objects")
    (folder / "SENSOR.yaml").write_text("skin_radius_mm: 20\nvisible_half_angle_deg: 60\n")
    for name in ("images", "damaged", "empty"):
        (folder / name).mkdir()
    for name in ("images", "damaged"):
        for k in range(5):
            cv2.imwrite(str(folder / name / f"{k}.png"), TOUCHED if k else FREE)
    (folder / "damaged/9.png").write_bytes((folder / "images/1.png").read_bytes()[:200])
    cv2.imwrite(str(folder / "small.png"), np.zeros((20, 20), np.uint8))
    rows = [f"{k % 5}.png,{k},{k}\n" for k in range(60)]
    head = "image,force_z_n,group\n"
    for name, more in (("", []), ("LAST_MISSING", ["none.png,1,1\n"])):
        (folder / f"images/{name or 'LABELS'}.csv").write_text("".join((head, *rows, *more)))
    (folder / "images/FEW.csv").write_text("".join((head, *rows[:2])))
    (folder / "images/LAST_SMALL.csv").write_text("".join((head, *rows, "../small.png,1,1\n")))
    header = "image,indenter,radius_mm,depth_mm,x_mm,y_mm\n"
    (folder / "PRESSES.csv").write_text(f"{header}images/1.png,ball,4,1,0,0\n")
    (folder / "missing.csv").write_text(f"{header}none.png,ball,4,1,0,0\n")
    (folder / "POSES.csv").write_text(
        "image,x_mm,y_mm,z_mm,qw,qx,qy,qz\nimages/1.png,0,0,0,1,0,0,0\n"
    )
    settings = {"calibration": "cal.npz", "source": {"kind": "simulated"}}
    (folder / "config.yaml").write_text(yaml.safe_dump(settings))
    (folder / "objects.yaml").write_text(yaml.safe_dump(settings | {"calibration": "taught.npz"}))
    write_recording(folder / "recording", [FREE, TOUCHED])
    shutil.copy(folder / "cal.npz", folder / "recording/calibration.npz")
    record_hand(folder / "hand")
    return folder


@pytest.fixture(autouse=True)
def idle(stage: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No command's work may begin."""
    monkeypatch.chdir(stage)

    def work(*_: object, **__: object) -> None:
        raise AssertionError("the work began")

    for command, names in WORK.items():
        module = importlib.import_module(f"{COMMANDS}.{command}")
        for name in names:
            monkeypatch.setattr(module, name, work)
    monkeypatch.setattr("tacshade_edge.hand.hand_recordings.step_and_track", work)


def one_line(words: list[str], code: int, capsys: pytest.CaptureFixture[str]) -> str:
    """The only line of a command that ends with this code."""
    before = {path: path.lstat().st_mtime_ns for path in Path().rglob("*") if path.is_file()}
    assert main(words) == code
    said = capsys.readouterr()
    assert not said.out
    assert said.err.count("\n") == 1, said.err
    assert said.err.startswith("tacshade-edge: ")
    after = {path: path.lstat().st_mtime_ns for path in Path().rglob("*") if path.is_file()}
    assert before == after
    return said.err


@pytest.mark.parametrize(
    ("line", "named"),
    [
        pytest.param(*each, id=each[0], marks=NEEDS_FIT if is_fit(each[0]) else ())
        for each in BAD_INPUTS
    ],
)
def test_a_bad_input_ends_a_command_before_its_work(
    line: str, named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert named in one_line(line.split(), EXIT_CONFIG, capsys)
    assert not Path("new").exists()


@pytest.mark.parametrize("line", TO_FILE)
@pytest.mark.parametrize("bad", ["folder", "parent", "part", "device", "closed", "long", "full"])
def test_a_file_that_cannot_be_written_ends_a_command_before_its_work(
    line: str,
    bad: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out, is_export = tmp_path / "new.npz", line.startswith("export")
    match bad:
        case "folder":
            out.mkdir()
        case "parent":
            (tmp_path / "file").touch()
            out = tmp_path / "file" / "new.npz"
        case "part":
            if is_export:
                pytest.skip("an export removes what one that was killed left")
            (tmp_path / "new.npz.part").mkdir()
        case "device":
            out.symlink_to("/dev/full")
        case "closed":
            out = Path("/proc/new.npz")
        case "long":
            out = tmp_path / ("n" * 252)
        case "full":
            monkeypatch.setattr("shutil.disk_usage", lambda _: _Usage(2**30, 2**30, 0))
    exists = is_export and bad in ("folder", "device")
    said = one_line([*line.split(), str(out)], EXIT_CONFIG if exists else EXIT_FAILED, capsys)
    named = (out.name[:200], f"{out.parent}: cannot write it", "/dev/full: cannot write it")
    assert (
        "found 0 MiB free on the disk" in said
        if bad == "full"
        else any(name in said for name in named)
    )


@pytest.mark.parametrize("line", TO_FOLDER)
@pytest.mark.parametrize("bad", ["file", "parent", "inside", "closed", "full"])
def test_a_folder_that_cannot_be_written_ends_a_command_before_its_work(
    line: str,
    bad: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "new"
    match bad:
        case "file":
            out.touch()
        case "parent":
            (tmp_path / "file").touch()
            out = tmp_path / "file" / "new"
        case "inside":
            (out / TO_FOLDER[line]).mkdir(parents=True)
        case "closed":
            out = Path("/proc/new")
        case "full":
            monkeypatch.setattr("shutil.disk_usage", lambda _: _Usage(2**30, 2**30, 0))
    said = one_line([*line.split(), str(out)], EXIT_FAILED, capsys)
    assert str(out) in said or "file: cannot write it: Not a directory" in said
    assert out.exists() == (bad in ("file", "inside"))


@pytest.mark.parametrize("line", TO_FOLDER)
def test_a_second_one_in_a_folder_is_told_who_writes_there(
    line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new"
    with owned_folder(out, "demo"):
        said = one_line([*line.split(), str(out)], EXIT_FAILED, capsys)
        assert f"another demo (pid {os.getpid()}) is writing {out} since " in said
        assert len(list(out.iterdir())) == 1  # the lock's file
    assert not out.exists()


def test_the_objects_file_is_looked_at_before_a_touch(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy("cal.npz", tmp_path / "cal.npz")
    (tmp_path / "cal.objects.npz").mkdir()
    where = ["--calibration", str(tmp_path / "cal.npz")]
    said = one_line(["teach", "ball", "images", *where], EXIT_FAILED, capsys)
    assert "cal.objects.npz: cannot write it: Is a directory" in said


def test_a_fit_looks_at_the_folder_of_its_steps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tacshade_edge.cli.shared.fit_option.need", lambda *_: None)
    (tmp_path / "new.npz.fit").touch()
    said = one_line([*FIT.split(), "--out", str(tmp_path / "new.npz")], EXIT_FAILED, capsys)
    assert "new.npz.fit: cannot write it: File exists" in said


def test_an_output_that_no_profile_has_is_refused_at_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["tradeoff", "--outputs", "touch", "--sensors", "default"])
    assert ended.value.code == EXIT_USAGE
    assert "have no touch" in capsys.readouterr().err


def test_every_command_that_works_for_long_is_here() -> None:
    lines = [*TO_FILE, *TO_FOLDER, *(line for line, _ in BAD_INPUTS)]
    assert {line.split()[0] for line in lines} == set(WORK)
