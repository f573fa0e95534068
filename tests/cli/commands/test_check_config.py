from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacshade_edge.cli import EXIT_CONFIG, main
from tacshade_edge.settings import file_schema
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.painted_sensor import painted_calibration

GOOD = "calibration: c.npz\nsource: {kind: simulated}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    return tmp_path


def check(folder: Path, text: str) -> int:
    path = folder / "s.yaml"
    path.write_text(text)
    return main(["check-config", str(path)])


def test_a_good_file_is_ok(folder: Path, capsys: Any) -> None:
    (folder / "password").write_text("secret\n")
    assert check(folder, GOOD + "mqtt: {username: a, password_file: password}\n") == 0
    assert capsys.readouterr().out == f"{folder}/s.yaml: ok\n"


def test_a_missing_calibration_is_a_warning_with_the_next_command(folder: Path, capsys: Any) -> None:
    assert check(folder, "source: {kind: simulated}\ncalibration: none.npz\n") == 0
    good, warning = capsys.readouterr().out.splitlines()
    assert good == f"{folder}/s.yaml: ok"
    assert warning.startswith(
        f"{folder}/s.yaml:2: calibration: warning: not calibrated: found no file {folder}/none.npz"
    )
    assert f"tacshade-edge capture DIR --config {folder}/s.yaml" in warning


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (GOOD + "mqtt: {prot: 1}\n", "s.yaml:3: mqtt.prot: found an unknown key"),
        ("calibration: s.yaml\nsource: {kind: simulated}\n", "s.yaml:1: calibration: {folder}/s.yaml: "),
        ("calibration: cut.npz\nsource: {kind: simulated}\n", "s.yaml:1: calibration: {folder}/cut.npz: "),
        ("calibration: one.npy\nsource: {kind: simulated}\n", "s.yaml:1: calibration: {folder}/one.npy: "),
        ("calibration: c.npz\n", "s.yaml: source.width_px: found 640x480 px"),
        (
            "calibration: c.npz\nsource: {kind: files, path: absent}\n",
            "s.yaml:2: source.path: {folder}/absent: found nothing, expected",
        ),
        (GOOD + "mqtt: {ca_file: no.pem}\n", "s.yaml:3: mqtt.ca_file: found no file {folder}/no.pem"),
        (GOOD + "mqtt: {ca_file: empty}\n", "s.yaml:3: mqtt: CA certificate file {folder}/empty: "),
        (GOOD + "mqtt: {username: a, password_file: absent}\n", "s.yaml:3: mqtt.password_file: {folder}/absent: No"),
        (GOOD + "mqtt: {password_file: s.yaml}\n", "s.yaml:3: mqtt.password_file: found a password without a user"),
        (
            GOOD + "mqtt: {username: a, password_file: empty}\n",
            "s.yaml:3: mqtt.password_file: {folder}/empty: found an",
        ),
        (
            GOOD + "mqtt: {username: a, password_file: c.npz}\n",
            "s.yaml:3: mqtt.password_file: {folder}/c.npz: found bytes that",
        ),
    ],
)
def test_a_mistake_is_one_line_and_exit_78(folder: Path, capsys: Any, text: str, said: str) -> None:
    (folder / "empty").touch()
    np.save(folder / "one.npy", np.zeros(3))
    (folder / "cut.npz").write_bytes((folder / "c.npz").read_bytes()[:-300])
    assert check(folder, text) == EXIT_CONFIG
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"tacshade-edge: {folder}/{said.format(folder=folder)}")
    assert printed.err.count("\n") == 1


def test_the_broker_of_a_hand_is_checked(folder: Path, capsys: Any) -> None:
    finger = "{calibration: c.npz, source: {kind: simulated}, hand_T_sensor: [0, 0, 0, 1, 0, 0, 0]%s}"
    text = (
        "hand_id: left\nmqtt: {username: left, password_file: %s}\nsensors:\n  a: "
        + finger % ", mqtt: {password_file: a}"
    )
    (folder / "a").write_text("word\n")
    assert check(folder, text % "none") == EXIT_CONFIG
    assert capsys.readouterr().err.startswith(
        f"tacshade-edge: {folder}/s.yaml:2: mqtt.password_file: {folder}/none: No"
    )
    assert check(folder, text % "a") == 0


def test_every_mistake_is_told_at_once(folder: Path, capsys: Any) -> None:
    text = """\
sensr_id: hand
profile: balancd
latency_budget_ms: .inf
mqtt: {prot: 1, port: 0}
source: {kind: v4l2, fps: fast, widht_px: 3}
serial: {baud: 1}
"""
    assert check(folder, text) == EXIT_CONFIG
    lines = capsys.readouterr().err.splitlines()
    path = f"tacshade-edge: {folder}/s.yaml"
    expected = [
        f"{path}:1: sensr_id: found an unknown key",
        f"{path}:2: profile: found balancd",
        f"{path}:3: latency_budget_ms: found .inf",
        f"{path}:4: mqtt.prot: found an unknown key",
        f"{path}:4: mqtt.port: found 0",
        f"{path}:5: source.fps: found fast",
        f"{path}:5: source.widht_px: found an unknown key",
        f"{path}:6: serial.baud: found 1",
        f"{path}: serial.device: found nothing",
    ]
    assert [line[: len(start)] for line, start in zip(lines, expected, strict=True)] == expected
    for k, nearest in ((0, "sensor_id"), (1, "balanced"), (3, "port"), (6, "width_px")):
        assert lines[k].endswith(f"; did you mean {nearest}?")


def test_every_file_that_is_wrong_is_told_at_once(folder: Path, capsys: Any) -> None:
    text = "calibration: s.yaml\nsource: {kind: files, path: absent}\nmqtt: {ca_file: no.pem}\n"
    assert check(folder, text) == EXIT_CONFIG
    said = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[1:3] for line in said] == [
        [f"{folder}/s.yaml:2", "source.path"],
        [f"{folder}/s.yaml:3", "mqtt.ca_file"],
        [f"{folder}/s.yaml:1", "calibration"],
    ]


def test_a_missing_file_is_one_line_and_exit_78(tmp_path: Path, capsys: Any) -> None:
    assert main(["check-config", str(tmp_path / "none.yaml")]) == EXIT_CONFIG
    expected = f"tacshade-edge: {tmp_path}/none.yaml: No such file or directory, expected a settings file\n"
    assert capsys.readouterr().err == expected


def test_the_schema_is_printed_without_a_file(capsys: Any) -> None:
    assert main(["check-config", "--schema"]) == 0
    assert json.loads(capsys.readouterr().out) == file_schema()
