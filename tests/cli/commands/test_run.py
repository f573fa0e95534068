"""The daemon as its users run it: a child process, its exit code, its one line."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from tacshade_edge.protocol import wire
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber, free_port
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration, touched_depth_mm
from tools.testbed.patience import patience, stretched, wait_until

pytestmark = pytest.mark.slow

STOP_S = 2.0
BASE = "tacshade/tacshade"
needs_broker = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
Child = subprocess.Popen[str]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A calibration, and a looped recording of a press."""
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    (tmp_path / "images").mkdir()
    for i, image in enumerate([FREE] * 3 + [TOUCHED] * 5):
        cv2.imwrite(str(tmp_path / "images" / f"{i}.png"), image)
    return tmp_path


def settings(folder: Path, port: int, source: str = "kind: files, path: images, fps: 100, loop: true") -> Path:
    path = folder / "settings.yaml"
    path.write_text(f"calibration: c.npz\nsource: {{{source}}}\nmqtt: {{host: 127.0.0.1, port: {port}}}\n")
    return path


@pytest.fixture
def start() -> Iterator[Callable[[Path], Child]]:
    children: list[Child] = []

    def started(path: Path) -> Child:
        command = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(path)]
        children.append(subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True))
        return children[-1]

    yield started
    for child in children:
        child.kill()
        child.communicate()


def terminated(child: Child, number: signal.Signals) -> tuple[int, str]:
    """Exit code and stderr after a signal, within the promised time."""
    began = time.monotonic()
    child.send_signal(number)
    _, errors = child.communicate(timeout=patience(20))
    assert time.monotonic() - began < stretched(STOP_S)
    return child.returncode, errors


def state(seen: Subscriber) -> str:
    return (seen.of(f"{BASE}/state") or [b""])[-1].decode()


@pytest.mark.broker
@needs_broker
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_it_cleanly(folder: Path, start: Callable[[Path], Child], number: signal.Signals) -> None:
    with Broker(folder) as broker, Subscriber(broker.port) as seen:
        child = start(settings(folder, broker.port))
        height = wire.decode(seen.wait_for(f"{BASE}/height", 20, 15)[-1])
        assert isinstance(height, wire.HeightMessage)
        heights = [wire.decode(p) for p in seen.of(f"{BASE}/height")]
        deepest = max(float(np.nanmax(h.height_mm)) for h in heights if isinstance(h, wire.HeightMessage))
        assert deepest == pytest.approx(touched_depth_mm(), abs=0.001)
        assert state(seen) == "online"
        code, errors = terminated(child, number)
        assert code == 0, errors
        wait_until(lambda: state(seen) == "stopped", 5, "stopped")
        assert "Traceback" not in errors
        assert len(errors.splitlines()) < 10  # state changes, not frames


@pytest.mark.broker
@needs_broker
def test_a_killed_daemon_leaves_its_last_will(folder: Path, start: Callable[[Path], Child]) -> None:
    with Broker(folder) as broker, Subscriber(broker.port) as seen:
        child = start(settings(folder, broker.port))
        seen.wait_for(f"{BASE}/height", 1, 15)
        child.kill()
        wait_until(lambda: state(seen) == "offline", 5, "offline")


def test_without_broker_and_camera_it_waits_and_stops_cleanly(folder: Path, start: Callable[[Path], Child]) -> None:
    source = "kind: v4l2, device: /dev/video99, width_px: 160, height_px: 120"
    child = start(settings(folder, free_port(), source))
    assert child.stderr is not None
    lines = []
    for line in child.stderr:
        lines.append(line)
        if "/dev/video99" in line:
            break
    code, errors = terminated(child, signal.SIGTERM)
    assert code == 0, errors
    assert "Traceback" not in "".join(lines) + errors


def test_a_wrong_setting_is_one_line_and_exit_78(folder: Path, start: Callable[[Path], Child]) -> None:
    path = settings(folder, 1883)
    path.write_text(path.read_text().replace("port", "prot"))
    child = start(path)
    out, errors = child.communicate(timeout=patience(20))
    assert (child.returncode, out) == (78, "")
    assert errors.startswith(f"tacshade-edge: {path}:3: mqtt.prot: found an unknown key, expected one of host, port")
    assert errors.count("\n") == 1


def test_a_source_that_can_never_work_is_one_line_and_exit_78(folder: Path, start: Callable[[Path], Child]) -> None:
    (folder / "void").mkdir()
    child = start(settings(folder, free_port(), "kind: files, path: void"))
    _, errors = child.communicate(timeout=patience(20))
    assert child.returncode == 78
    told = [line for line in errors.splitlines() if line.startswith("tacshade-edge: ")]
    assert told == [line for line in told if f"{folder}/void: found no image" in line]
    assert len(told) == 1
    assert "Traceback" not in errors


def test_a_defect_in_a_thread_ends_the_process_with_a_traceback(folder: Path) -> None:
    code = (
        "from tacshade_edge.cli.entry import entry; from tacshade_edge.storage.recording import image_source\n"
        "def read(self): raise ZeroDivisionError('a defect')\n"
        "image_source.FilesSource.read = read\n"
        "entry()"
    )
    words = ["run", "--config", str(settings(folder, free_port()))]
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=patience(20), check=False
    )
    assert done.returncode == 1
    assert "Traceback" in done.stderr
    assert done.stderr.rstrip().endswith("ZeroDivisionError: a defect\nin thread grab")
