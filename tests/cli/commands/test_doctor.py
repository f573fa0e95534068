from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from functools import partial
from pathlib import Path

import cv2
import pytest

from support.mqtt_rig import Broker, free_port
from support.painted_sensor import FREE, painted_calibration
from support.patience import patience
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import EXIT_CONFIG, EXIT_FAILED, EXIT_OK, main
from tacshade_edge.cli.commands.doctor import shown
from tacshade_edge.doctor import fault, warning
from tacshade_edge.doctor.tail import measure_tail


def write(folder: Path, port: int, more: str = "") -> str:
    calibration_file.save(folder / "c.npz", painted_calibration())
    cv2.imwrite(str(folder / "a.png"), FREE)
    path = folder / "s.yaml"
    source = "source: {kind: files, path: a.png, fps: 240, loop: true}\n"
    path.write_text(f"calibration: c.npz\nmqtt: {{host: 127.0.0.1, port: {port}}}\n{source}{more}")
    return str(path)


def test_a_fault_is_exit_1_its_fix_stands_below_and_the_bundle_has_all(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, bundle = write(tmp_path, free_port()), tmp_path / "b.zip"
    assert (
        main(["doctor", "--config", config, "--bundle", str(bundle), "--with-frame"]) == EXIT_FAILED
    )
    printed = capsys.readouterr()
    *lines, counts, wrote = printed.out.splitlines()
    assert printed.err == ""
    assert lines[0] == f"ok       settings           {config}, sensor tacshade"
    assert lines[1].startswith("fault    broker             127.0.0.1:")
    assert lines[2].startswith("         -> start the broker: sudo systemctl")
    assert counts.startswith("faults: 1, ")
    assert "\x1b" not in printed.out, "colour only on a terminal"
    assert wrote.startswith(f"wrote {bundle}; look through it")
    with zipfile.ZipFile(bundle) as files:
        assert {"findings.json", "frame.png", "settings.yaml"} <= set(files.namelist())
        assert json.loads(files.read("findings.json"))[0]["check"] == "settings"


def test_json_of_bad_settings_is_a_list_and_exit_78(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write(tmp_path, 1883, more="sensor: 1\n")
    assert main(["doctor", "--config", config, "--json"]) == EXIT_CONFIG
    found = json.loads(capsys.readouterr().out)
    assert all(set(each) == {"check", "state", "found", "fix"} for each in found)
    assert (found[0]["check"], found[0]["state"]) == ("settings", "fault")
    assert {each["check"] for each in found} >= {"serial", "disk", "clock", "camera"}


@pytest.mark.broker
def test_no_fault_is_exit_0_in_a_process_of_its_own(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker:
        command = [
            sys.executable,
            "-m",
            "tacshade_edge",
            "doctor",
            "--config",
            write(tmp_path, broker.port),
        ]
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=patience(60), check=False
        )
    assert (done.returncode, done.stderr) == (EXIT_OK, ""), done.stdout
    assert "fault " not in done.stdout


def test_how_a_finding_is_shown() -> None:
    assert (
        shown(warning("a", "b", "c"), colour=False)
        == "warning  a                  b\n         -> c"
    )
    assert shown(fault("a", "b", "c"), colour=True).startswith("\x1b[31mfault  \x1b[0m  a ")


def test_of_pictures_it_shows_each_judge_with_its_figures_and_limits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    (tmp_path / "in").mkdir()
    pictures = {"black": FREE * 0, "free": FREE, "small": FREE[:-20], "dim": FREE // 3}
    for name, picture in pictures.items():
        cv2.imwrite(str(tmp_path / "in" / f"{name}.png"), picture)
    (tmp_path / "in" / "cut.png").write_bytes(b"\x89PNG")
    words = [
        "doctor",
        str(tmp_path / "in"),
        "--calibration",
        str(tmp_path / "c.npz"),
        "--profile",
        "paper",
    ]
    assert main(words) == EXIT_FAILED
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:5]] == [
        "refused",
        "refused",
        "refused",
        "passes",
        "refused",
    ]
    assert lines[-1] == "1 of 5 pass"
    assert main([*words, "--json"]) == EXIT_FAILED
    found = {Path(each["image"]).stem: each for each in json.loads(capsys.readouterr().out)}
    judges = {name: (each["judge"], each["reason_code"]) for name, each in found.items()}
    assert judges == {
        "black": ("picture", "black"),
        "cut": ("picture", "decode"),
        "dim": ("light", "light"),
        "free": (None, ""),
        "small": ("picture", "size"),
    }
    figures = {each["what"]: each for each in found["dim"]["figures"]}
    assert figures["light of the brightest"]["found"] < figures["light of the brightest"]["least"]
    assert figures["light of the brightest"]["most"] is None
    assert {each["judge"] for each in found["free"]["figures"]} == {
        "picture",
        "light",
        "camera",
        "skin",
    }


def test_pictures_need_a_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = write(tmp_path, 1883)
    assert (
        main(["doctor", str(tmp_path / "a.png"), "--config", config, "--profile", "paper"])
        == EXIT_OK
    )
    (tmp_path / "c.npz").unlink()
    assert main(["doctor", str(tmp_path / "a.png"), "--config", config]) == EXIT_CONFIG
    assert "found no file" in capsys.readouterr().err


def test_the_tail_is_measured_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    short = partial(measure_tail, work_ms=0.2, rate_hz=200.0, seconds=0.05)
    monkeypatch.setattr("tacshade_edge.cli.commands.doctor.measure_tail", short)
    assert main(["doctor", "--tail", "--json"]) == EXIT_OK
    assert {each["check"] for each in json.loads(capsys.readouterr().out)} == {"tail"}
    with pytest.raises(SystemExit):
        main(["doctor", "--tail", "picture.png"])
    assert "--tail: found images" in capsys.readouterr().err
