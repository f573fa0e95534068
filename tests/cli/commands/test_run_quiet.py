"""`run -q` is silent while all is well, and names each fault of broker, camera and calibration with its fix."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.painted_sensor import FREE, painted_calibration
from tools.testbed.patience import patience, wait_until

needs_broker = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
Lines = Callable[[], list[str]]


@pytest.fixture
def run_quietly(tmp_path: Path) -> Iterator[Callable[..., Lines]]:
    """Starts `run -q` with settings, and gives the lines of its log so far."""
    children: list[subprocess.Popen[bytes]] = []

    def start(port: int, source: str, more: str = "") -> Lines:
        path, log = tmp_path / "settings.yaml", tmp_path / "log"
        path.write_text(f"calibration: c.npz\nsource: {{{source}}}\nmqtt: {{host: 127.0.0.1, port: {port}{more}}}\n")
        command = [sys.executable, "-m", "tacshade_edge", "run", "-q", "--config", str(path)]
        with log.open("wb") as file:
            children.append(subprocess.Popen(command, stderr=file))
        return lambda: log.read_text().splitlines()

    yield start
    for child in children:
        child.terminate()
        assert child.wait(patience(10)) == 0


def images(folder: Path, image: np.ndarray) -> str:
    folder.mkdir()
    cv2.imwrite(str(folder / "0.png"), image)
    return f"kind: files, path: {folder}, fps: 30, loop: true"


def say(lines: Lines, *parts: str) -> bool:
    """Whether one line is a warning with all of these parts."""
    return any(" WARNING " in line and all(part in line for part in parts) for line in lines())


@pytest.mark.broker
@needs_broker
@pytest.mark.slow
def test_a_broker_that_refuses_and_frames_that_are_all_black(tmp_path: Path, run_quietly: Callable[..., Lines]) -> None:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    (tmp_path / "password").write_text("wrong\n")
    more = f", username: hand, password_file: {tmp_path}/password"
    with Broker(tmp_path, users={"hand": "right"}) as broker:
        lines = run_quietly(broker.port, images(tmp_path / "images", 0 * FREE), more)
        wait_until(lambda: say(lines, "rejects the connection: Not authorized; to fix it: is the password right?"), 20)
        wait_until(lambda: say(lines, "source unusable: ", "black", "to fix it: switch the sensor's light on"), 20)


@pytest.mark.broker
@needs_broker
def test_no_calibration(tmp_path: Path, run_quietly: Callable[..., Lines]) -> None:
    with Broker(tmp_path) as broker:
        lines = run_quietly(broker.port, images(tmp_path / "images", FREE))
        wait_until(
            lambda: say(lines, "source unusable: not calibrated: found no file", "tacshade-edge capture DIR"), 20
        )


@pytest.mark.broker
@needs_broker
def test_silence_while_all_is_well(tmp_path: Path, run_quietly: Callable[..., Lines]) -> None:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    with Broker(tmp_path) as broker, Subscriber(broker.port, "tacshade/+/health") as seen:
        lines = run_quietly(broker.port, images(tmp_path / "images", FREE))
        wait_until(lambda: b'"without_contact": 0' not in b"".join(m.payload for m in seen.messages[-1:]) != b"", 20)
        assert lines() == []
