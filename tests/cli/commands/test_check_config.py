from __future__ import annotations

import json
from pathlib import Path

import pytest

from support.painted_sensor import painted_calibration
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import EXIT_CONFIG, main
from tacshade_edge.settings import file_schema

GOOD = "calibration: c.npz\nsource: {kind: simulated}\n"
FINGER = "{calibration: c.npz, source: {kind: simulated}, hand_T_sensor: [0, 0, 0, 1, 0, 0, 0]%s}"
HAND = "hand_id: left\nmqtt: {username: left, password_file: %s}\nsensors:\n  a: "


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    (tmp_path / "a").write_text("word\n")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "c.npz").read_bytes()[:-300])
    return tmp_path


def check(folder: Path, text: str) -> int:
    path = folder / "s.yaml"
    path.write_text(text)
    return main(["check-config", str(path)])


def test_a_good_file_is_ok(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert check(folder, GOOD + "mqtt: {username: a, password_file: a}\n") == 0
    assert capsys.readouterr().out == f"{folder}/s.yaml: ok\n"
    assert check(folder, HAND % "a" + FINGER % ", mqtt: {password_file: a}") == 0
    assert main(["check-config", "--schema"]) == 0
    assert json.loads(capsys.readouterr().out.partition("\n")[2]) == file_schema()


def test_fingers_in_centimetres_are_a_warning(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration_file.save(folder / "d.npz", painted_calibration())
    other = FINGER.replace("c.npz", "d.npz") % ""
    text = "hand_id: left\nsensors:\n  a: " + FINGER % "" + "\n  b: " + other
    assert check(folder, text.replace("[0, 0, 0, 1", "[0, 3, 2, 1", 1)) == 0
    good, warning = capsys.readouterr().out.splitlines()
    assert good == f"{folder}/s.yaml: ok"
    assert warning.startswith(f"{folder}/s.yaml:4: sensors.b.hand_T_sensor: warning: found 3.6 mm")
    assert warning.endswith("are they in cm?")


def test_a_missing_calibration_is_a_warning_with_the_next_command(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert check(folder, "source: {kind: simulated}\ncalibration: none.npz\n") == 0
    good, warning = capsys.readouterr().out.splitlines()
    assert good == f"{folder}/s.yaml: ok"
    assert warning.startswith(f"{folder}/s.yaml:2: calibration: warning: not calibrated: ")
    assert f"tacshade-edge capture DIR --config {folder}/s.yaml" in warning


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (GOOD + "mqtt: {prot: 1}\n", ":3: mqtt.prot: found an unknown key"),
        (
            "calibration: cut.npz\nsource: {kind: simulated}\n",
            ":1: calibration: {folder}/cut.npz: ",
        ),
        (
            "calibration: c.npz\nsource: {kind: v4l2, width_px: 800, height_px: 600}\n",
            ":2: source.width_px: found 800x600 px",
        ),
        (
            "calibration: c.npz\nsource: {kind: v4l2, height_px: 600}\n",
            ":2: source: found no width_px, expected both width_px and height_px, or neither",
        ),
        (
            "calibration: c.npz\nsource: {kind: files, path: absent}\n",
            ":2: source.path: {folder}/absent: ",
        ),
        (GOOD + "mqtt: {ca_file: no.pem}\n", ":3: mqtt.ca_file: found no file {folder}/no.pem"),
        (
            GOOD + "mqtt: {username: a, password_file: absent}\n",
            ":3: mqtt.password_file: {folder}/absent: No",
        ),
        (
            GOOD + "mqtt: {password_file: s.yaml}\n",
            ":3: mqtt.password_file: found a password without a user",
        ),
        (
            HAND % "none" + FINGER % ", mqtt: {password_file: a}",
            ":2: mqtt.password_file: {folder}/none: No",
        ),
    ],
)
def test_a_mistake_is_one_line_and_exit_78(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    assert check(folder, text) == EXIT_CONFIG
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("\n")) == ("", 1)
    assert printed.err.startswith(f"tacshade-edge: {folder}/s.yaml{said.format(folder=folder)}")


def test_all_files_that_the_settings_name_are_checked(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "calibration: s.yaml\nsource: {kind: files, path: absent}\nmqtt: {ca_file: no.pem}\n"
    assert check(folder, text) == EXIT_CONFIG
    lines = capsys.readouterr().err.splitlines()
    starts = [
        f"tacshade-edge: {folder}/s.yaml{at}: "
        for at in (":2: source.path", ":3: mqtt.ca_file", ":1: calibration")
    ]
    assert [line[: len(start)] for line, start in zip(lines, starts, strict=True)] == starts


@pytest.mark.parametrize(
    ("text", "nearest"),
    [
        ("sensr_id: hand\n", "sensor_id"),
        ("profile: balancd\n", "balanced"),
        ("source: {kind: v4l2, widht_px: 3}\n", "width_px"),
    ],
)
def test_a_near_name_is_suggested(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str, nearest: str
) -> None:
    assert check(folder, text) == EXIT_CONFIG
    assert capsys.readouterr().err.endswith(f"; did you mean {nearest}?\n")
