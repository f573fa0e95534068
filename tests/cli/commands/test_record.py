"""`record` against the real daemon, both as their users run them."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.mqtt_rig import Broker, Subscriber, free_port
from support.painted_sensor import FREE, TOUCHED, painted_calibration
from support.patience import patience, wait_until
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import main
from tacshade_edge.recording.frame_table import HEADER, read_table
from tacshade_edge.recording.runs import HEIGHTS, payloads
from tacshade_edge.settings import load
from tacshade_edge.wire import binary

pytestmark = [pytest.mark.slow, pytest.mark.broker]
BASE = "tacshade/tacshade"
Child = subprocess.Popen[str]
Start = Callable[..., Child]


@pytest.fixture
def start(tmp_path: Path, broker: Broker, seen: Subscriber) -> Iterator[Start]:
    """Starts a command with the settings; `run` is waited for until it streams a looped press."""
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    (tmp_path / "images").mkdir()
    noise = np.random.default_rng(3)
    for i, image in enumerate([FREE] * 3 + [TOUCHED] * 30):
        noisy = np.clip(image + noise.normal(0, 4, image.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(tmp_path / "images" / f"{i:02d}.png"), noisy)
    rows = [f"{i:02d}.png,{i},{i / 7},2,3,0,0,-1,0\n" for i in range(33)]
    (tmp_path / "images" / "frames.csv").write_text(",".join(HEADER) + "\n" + "".join(rows))
    write_settings(tmp_path, broker.port)
    children: list[Child] = []

    def started(*words: str) -> Child:
        command = [
            sys.executable,
            "-m",
            "tacshade_edge",
            words[0],
            "--config",
            str(tmp_path / "s.yaml"),
            *words[1:],
        ]
        pipes: dict[str, Any] = {
            "stdout": subprocess.PIPE,
            "stderr": subprocess.PIPE,
            "stdin": subprocess.DEVNULL,
        }
        children.append(subprocess.Popen(command, text=True, **pipes))
        if words[0] == "run":
            seen.wait_for(f"{BASE}/height", 1, 20)
        return children[-1]

    yield started
    for child in children:
        child.kill()
        child.communicate()


@pytest.fixture(autouse=True)
def signals() -> Iterator[None]:
    """The command takes the signals of its process, which is ours here."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def write_settings(folder: Path, port: int) -> None:
    source = "source: {kind: files, path: images, fps: 30, loop: true}"
    broker = f"mqtt: {{host: 127.0.0.1, port: {port}}}"
    (folder / "s.yaml").write_text(
        f"calibration: c.npz\n{source}\n{broker}\nrecorder: {{folder: recs}}\n"
    )


def record(folder: Path, seconds: str, *more: str) -> int:
    return main(["record", "--config", str(folder / "s.yaml"), "--seconds", seconds, *more])


def about(folder: Path) -> dict[str, Any]:
    read: dict[str, Any] = json.loads((folder / "recording.json").read_text())
    return read


def replayed(rec: Path, out: Path) -> list[binary.HeightMessage]:
    """The heights of a replay of a recording with the calibration beside it."""
    assert (
        main(["replay", str(rec), "--calibration", str(rec / "calibration.npz"), "--out", str(out)])
        == 0
    )
    heights = [binary.decode(payload) for payload in payloads(out, HEIGHTS)]
    return [height for height in heights if isinstance(height, binary.HeightMessage)]


def recording_frames(seen: Subscriber) -> int:
    status = json.loads((seen.of(f"{BASE}/status/recorder") or [b"{}"])[-1])
    return int(status.get("frames", 0)) if status.get("state") == "recording" else 0


def test_a_replay_of_the_recording_gives_what_the_daemon_published(
    tmp_path: Path, start: Start, seen: Subscriber, capsys: pytest.CaptureFixture[str]
) -> None:
    start("run")
    assert record(tmp_path, "2", "--name", "a") == 0
    rec = tmp_path / "recs" / "a"
    written = about(rec)
    assert capsys.readouterr() == (
        f"{rec}: {written['frames']} frames, {written['bytes'] / 1e6:.1f} MB\n",
        "",
    )
    assert (written["dropped"], written["ending"]) == (0, "time")
    assert not list(rec.glob("*.part"))
    again = {height.t_ns: height for height in replayed(rec, tmp_path / "run")}
    rows = read_table(rec / "frames.csv")
    assert len(rows) == written["frames"] == len(again) > 20
    live = [binary.decode(payload) for payload in seen.of(f"{BASE}/height")]
    meanwhile = [height for height in live if rows[0].t_ns <= height.t_ns <= rows[-1].t_ns]
    assert len(meanwhile) > 10
    for height in meanwhile:
        assert isinstance(height, binary.HeightMessage)
        assert height.height_mm.tobytes() == again[height.t_ns].height_mm.tobytes()
        assert height.pose == again[height.t_ns].pose
        assert (height.contact, height.calibration_crc32) == (
            again[height.t_ns].contact,
            written["calibration_crc32"],
        )
    settings, kept = load(tmp_path / "s.yaml").settings, load(rec / "settings.yaml").settings
    assert kept.calibration == str(rec / "calibration.npz")
    assert (kept.source, kept.mqtt, kept.recorder) == (
        settings.source,
        settings.mqtt,
        settings.recorder,
    )

    capsys.readouterr()  # a slow replay's progress
    assert record(tmp_path, "1", "--name", "a") == 1
    err = capsys.readouterr().err
    assert "a: already exists" in err
    assert err.count("\n") == 1


def test_a_signal_ends_the_recording_and_the_daemon_goes_on_until_it_is_stopped(
    tmp_path: Path, start: Start, seen: Subscriber
) -> None:
    daemon = start("run")
    client = start("record", "--seconds", "600")
    wait_until(lambda: recording_frames(seen) > 5, 30, "a recording")
    client.send_signal(signal.SIGINT)
    said, errors = client.communicate(timeout=patience(30))
    assert (client.returncode, errors) == (0, "")
    (rec,) = (tmp_path / "recs").iterdir()
    assert said.startswith(f"{rec}: {about(rec)['frames']} frames, ")
    assert said.endswith(" (stopped)\n")
    assert len(read_table(rec / "frames.csv")) == about(rec)["frames"] > 5
    seen.wait_for(f"{BASE}/height", len(seen.of(f"{BASE}/height")) + 10, 10)
    client = start("record", "--seconds", "600", "--name", "a")
    wait_until(lambda: recording_frames(seen) > 5, 30, "a recording")
    daemon.terminate()
    assert daemon.wait(patience(20)) == 0
    said, errors = client.communicate(timeout=patience(30))
    assert (client.returncode, errors) == (0, "")
    assert about(tmp_path / "recs" / "a")["ending"] == "the daemon stopped"


def test_what_cannot_be_asked_is_one_line(
    tmp_path: Path, broker: Broker, start: Start, capsys: pytest.CaptureFixture[str]
) -> None:
    port = free_port()
    cases = [
        (
            broker.port,
            f"127.0.0.1:{broker.port}: no answer from sensor tacshade within 3 s; is the daemon ",
        )
    ]
    cases += [
        (port, f"127.0.0.1:{port}: Connection refused; expected a broker"),
        (broker.port, f"{tmp_path}/recs: "),
    ]
    for at, said in cases:
        write_settings(tmp_path, at)
        if said.endswith("recs: "):
            (tmp_path / "recs").touch()
            start("run")
        assert record(tmp_path, "1") == 1
        error = capsys.readouterr().err
        assert error.startswith(f"tacshade-edge: {said}")
        assert error.count("\n") == 1
