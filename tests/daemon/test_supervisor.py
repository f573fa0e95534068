"""Several sensors of one file: the command as its users run it, a real broker, and a service manager's socket."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest

from tacshade_edge.cli import EXIT_CONFIG
from tacshade_edge.protocol import wire
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration
from tools.testbed.patience import patience, wait_until
from tools.testbed.robot import PtyRobot

pytestmark = [pytest.mark.broker, pytest.mark.slow]
needs_broker = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")


class Running:
    """The command, and what it tells a service manager."""

    def __init__(self, folder: Path) -> None:
        self._manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._manager.bind(str(folder / "notify"))
        self._manager.setblocking(False)
        self._told: list[str] = []
        self.log = folder / "log"
        with self.log.open("w") as log:
            self.process = subprocess.Popen(
                (sys.executable, "-m", "tacshade_edge", "run", "--config", str(folder / "hand.yaml")),
                env={**os.environ, "NOTIFY_SOCKET": str(folder / "notify")},
                stderr=log,
                stdin=subprocess.DEVNULL,
            )

    def told(self) -> list[str]:
        """Every line so far."""
        while True:
            try:
                self._told += self._manager.recv(65536).decode().split("\n")
            except BlockingIOError:
                return self._told

    def children(self) -> set[int]:
        """Its processes."""
        found = subprocess.run(("pgrep", "-P", str(self.process.pid)), capture_output=True, check=False)
        return {int(word) for word in found.stdout.split()}

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._manager.close()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Calibrations of three sensors, the third damaged, and looped images of a press."""
    for name in ("thumb", "index"):
        calibration_file.save(tmp_path / f"{name}.npz", painted_calibration())
        (tmp_path / name).mkdir()
        for i, image in enumerate([FREE] * 3 + [TOUCHED] * 5):
            cv2.imwrite(str(tmp_path / name / f"{i}.png"), image)
    (tmp_path / "ring.npz").write_bytes(b"no calibration")
    (tmp_path / "ring").symlink_to("index")
    return tmp_path


def write(folder: Path, port: int, *names: str) -> None:
    lines = [f"mqtt: {{host: 127.0.0.1, port: {port}}}", "recorder: {folder: recs}", "stitching: {folder: maps}"]
    lines += ["sensors:"]
    for name in names:
        lines += [f"  {name}: {{calibration: {name}.npz, source: {{kind: files, path: {name}, fps: 60, loop: true}}}}"]
    (folder / "hand.yaml").write_text("\n".join(lines) + "\n")


@pytest.fixture
def broker(folder: Path) -> Iterator[Broker]:
    with Broker(folder) as made:
        yield made


def write_hand(folder: Path, port: int, *names: str) -> None:
    """The same, as the fingers of a hand."""
    write(folder, port, *names)
    text = (
        (folder / "hand.yaml").read_text().replace("loop: true}}", "loop: true}, hand_T_sensor: [0, 0, 0, 1, 0, 0, 0]}")
    )
    (folder / "hand.yaml").write_text(f"hand_id: left\n{text}")


def health(seen: Subscriber, name: str) -> dict[str, Any]:
    payloads = seen.of(f"tacshade/{name}/health")
    return dict(json.loads(payloads[-1])) if payloads else {}


@needs_broker
def test_one_that_dies_or_cannot_start_touches_no_other(folder: Path, broker: Broker) -> None:
    write(folder, broker.port, "thumb", "index", "ring")
    with Subscriber(broker.port) as seen:
        running = Running(folder)
        try:
            wait_until(lambda: "READY=1" in running.told(), 20, "up with one that cannot start")
            wait_until(lambda: all(health(seen, name) for name in ("thumb", "index")), 20, "both publish")
            first = running.children()
            assert len(first) == 2
            states = {name: len(seen.of(f"tacshade/{name}/state")) for name in ("thumb", "index")}
            victim = min(first)
            os.kill(victim, signal.SIGKILL)
            wait_until(lambda: len(running.children() - {victim}) == 2, 20, "started again")
            wait_until(
                lambda: any("thumb: streaming" in t and "index: streaming" in t for t in running.told()[-4:]),
                20,
                "both stream",
            )
            assert any("ring: bad settings" in line for line in running.told())
            disturbed = [name for name in states if len(seen.of(f"tacshade/{name}/state")) > states[name]]
            assert len(disturbed) == 1, "the other never left the broker"
            (other,) = set(states) - set(disturbed)
            frames = health(seen, other)["frames"]
            assert frames["captured"] == sum(n for key, n in frames.items() if key != "captured")
            assert health(seen, other)["source_dropped"] == 0

            calibration_file.save(folder / "ring.npz", painted_calibration())
            running.process.send_signal(signal.SIGHUP)
            wait_until(lambda: bool(health(seen, "ring")), 20, "the fixed one runs after a reload")
            running.process.send_signal(signal.SIGTERM)
            assert running.process.wait(patience(10)) == 0
            seen.wait_for_last("tacshade/ring/state", b"stopped")
        finally:
            running.close()
    text = running.log.read_text()
    assert "sensors.ring.calibration: " in text
    assert "its process exited with -9" in text
    assert {"thumb", "index", "ring"} <= {line.split(": ")[1] for line in text.splitlines() if "INFO" in line}


@needs_broker
def test_one_that_a_signal_stops_is_started_again_the_hand_too(folder: Path, broker: Broker) -> None:
    write_hand(folder, broker.port, "thumb", "index")
    with Subscriber(broker.port) as seen:
        running = Running(folder)
        try:
            wait_until(lambda: all(health(seen, name) for name in ("thumb", "index", "hand/left")), 20, "all publish")
            for victim in sorted(running.children()):
                os.kill(victim, signal.SIGTERM)
                wait_until(lambda victim=victim: len(running.children() - {victim}) == 3, 20, "started again")
            seen.messages.clear()
            wait_until(lambda: all(health(seen, name) for name in ("thumb", "index", "hand/left")), 20, "all again")
            running.process.send_signal(signal.SIGTERM)
            assert running.process.wait(patience(10)) == 0
        finally:
            running.close()
    lines = [line.partition(" ERROR ")[2] for line in running.log.read_text().splitlines() if "a signal ended" in line]
    told = {line.split(": ")[1] for line in lines}
    assert told == {"thumb", "index", "hand/left"}
    assert all(line.endswith("a signal ended its process; restarting in 1 s") for line in lines)


@needs_broker
def test_one_that_ends_at_once_waits_longer_each_time_until_a_reload(folder: Path, broker: Broker) -> None:
    write(folder, broker.port, "thumb")
    running = Running(folder)
    try:
        for expected_s in (1, 2, 4):
            wait_until(lambda: len(running.children()) == 1, 20, "started")
            os.kill(running.children().pop(), signal.SIGKILL)
            told = f"thumb: its process exited with -9; restarting in {expected_s} s"
            wait_until(lambda told=told: told in running.log.read_text(), 20, told)
        running.process.send_signal(signal.SIGHUP)
        wait_until(lambda: len(running.children()) == 1, 20, "started by the reload")
        os.kill(running.children().pop(), signal.SIGKILL)
        wait_until(lambda: running.log.read_text().count("restarting in 1 s") == 2, 20, "from the beginning")
    finally:
        running.close()


def states(pid: int) -> set[str]:
    """The states of a process's threads, none if it has ended."""
    found = set()
    with contextlib.suppress(OSError):  # a thread ended meanwhile
        for path in Path(f"/proc/{pid}/task").glob("*/stat"):
            found.add(path.read_text().rpartition(")")[2].split()[0])
    return found - {"Z"}


def suspend(pid: int) -> None:
    """Send SIGSTOP and wait until every thread has stopped: the kernel wakes a process whose stop is incomplete."""
    os.kill(pid, signal.SIGSTOP)
    wait_until(lambda: states(pid) == {"T"}, 20, "each thread stands")


@needs_broker
def test_those_that_hang_end_with_their_supervisor(folder: Path, broker: Broker) -> None:
    write_hand(folder, broker.port, "thumb")
    with Subscriber(broker.port) as seen:
        running = Running(folder)
        try:
            wait_until(lambda: bool(health(seen, "thumb") and health(seen, "hand/left")), 20, "both publish")
            children = running.children()
            for child in children:
                suspend(child)
        finally:
            running.close()
        try:
            wait_until(lambda: not any(map(states, children)), 20, "they end, stopped as they are")
        finally:
            for child in filter(states, children):
                os.kill(child, signal.SIGKILL)


@needs_broker
def test_one_that_hangs_says_where_and_is_started_again(
    folder: Path, broker: Broker, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(folder, broker.port, "thumb", "index")
    with Subscriber(broker.port) as seen:
        running = Running(folder)
        try:
            wait_until(lambda: all(health(seen, name) for name in ("thumb", "index")), 20, "both publish")
            victim = min(running.children())
            os.kill(victim, signal.SIGSTOP)
            wait_until(lambda: victim not in running.children(), 40, "ended")
            wait_until(lambda: len(running.children()) == 2, 20, "started again")
            assert "ending the process, which has not responded for 10 s" in running.log.read_text()
        finally:
            running.close()
        wait_until(lambda: seen.of("tacshade/index/state")[-1:] == [b"stopped"], 20, "they end with their supervisor")


@needs_broker
def test_one_robots_line_gives_poses_to_every_sensor(folder: Path, broker: Broker) -> None:
    link = Path(f"/dev/shm/tacshade-hand-{os.getpid()}")
    write(folder, broker.port, "thumb", "index")
    config = folder / "hand.yaml"
    config.write_text(f"serial: {{device: {link}}}\n{config.read_text()}")

    def posed(seen: Subscriber, name: str) -> bool:
        return any(wire.decode(payload).pose for payload in seen.of(f"tacshade/{name}/height"))

    def shared(seen: Subscriber) -> tuple[str, str]:
        told = json.loads(seen.of("tacshade/index/status/serial")[-1])
        return told["state"], told["shared_by"]

    with Subscriber(broker.port) as seen, PtyRobot(link, rate_hz=100, binary=True):
        running = Running(folder)
        try:
            wait_until(lambda: posed(seen, "thumb") and posed(seen, "index"), 30, "both have poses")
            wait_until(lambda: shared(seen) == ("connected", "thumb"), 10, "index says whose line it is")
            running.process.send_signal(signal.SIGTERM)
            assert running.process.wait(patience(10)) == 0
        finally:
            running.close()


def test_no_settings_that_can_work_is_bad_configuration(folder: Path) -> None:
    write(folder, 1, "ring")
    running = Running(folder)
    try:
        assert running.process.wait(patience(20)) == EXIT_CONFIG
        assert "the file is damaged or not a calibration" in running.log.read_text()
    finally:
        running.close()
