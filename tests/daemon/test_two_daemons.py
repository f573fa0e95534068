"""Two daemons that share what belongs to one: the second says who has it, and the first loses nothing."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import pty
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest

from tacshade_edge.devices.mqtt.client import BrokerAddress
from tacshade_edge.doctor.broker import check_broker, judge_daemon
from tacshade_edge.doctor.machine import Process
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration
from tools.testbed.patience import patience, wait_until

pytestmark = [pytest.mark.broker, pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")]


class Daemon:
    """``tacshade-edge run`` in a process of its own, which does not outlive the ``with``."""

    def __init__(self, folder: Path, name: str, port: int, sensor_id: str, sessions: str, device: str) -> None:
        self._log = folder / f"{name}.log"
        settings = folder / f"{name}.yaml"
        settings.write_text(
            f"sensor_id: {sensor_id}\ncalibration: c.npz\nmqtt: {{host: 127.0.0.1, port: {port}}}\n"
            "source: {kind: files, path: images, fps: 30, loop: true}\n"
            f"serial: {{device: {device}}}\nstitching: {{folder: {sessions}}}\n"
        )
        command = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(settings)]
        with self._log.open("w") as log:
            self.process = subprocess.Popen(command, stderr=log)

    def __enter__(self) -> Daemon:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait(patience(10))

    def said(self, text: str) -> bool:
        assert self.process.poll() is None, self._log.read_text()
        return text in self._log.read_text()

    def stop(self) -> None:
        self.process.terminate()
        assert self.process.wait(patience(20)) == 0, self._log.read_text()


@pytest.fixture
def devices() -> Iterator[list[str]]:
    """Two serial ports with nobody at their other ends."""
    pairs = [pty.openpty() for _ in range(2)]
    yield [os.ttyname(slave) for _, slave in pairs]
    for descriptor in itertools.chain(*pairs):
        os.close(descriptor)


@pytest.mark.parametrize(
    ("same_id", "same_folder", "same_port"),
    [
        (True, True, True),
        pytest.param(True, False, False, marks=pytest.mark.slow),
        pytest.param(False, True, False, marks=pytest.mark.slow),
        pytest.param(False, False, True, marks=pytest.mark.slow),
    ],
)
def test_two_daemons(tmp_path: Path, devices: list[str], same_id: bool, same_folder: bool, same_port: bool) -> None:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    for name in ("images", "one", "two"):
        (tmp_path / name).mkdir()
    for i, image in enumerate([FREE] * 3 + [TOUCHED] * 5):
        cv2.imwrite(str(tmp_path / "images" / f"{i}.png"), image)
    with contextlib.ExitStack() as stack:
        broker = stack.enter_context(Broker(tmp_path))
        seen = stack.enter_context(Subscriber(broker.port))
        first = stack.enter_context(Daemon(tmp_path, "first", broker.port, "left", "one", devices[0]))

        def health(sensor_id: str) -> Any:
            payloads = seen.of(f"tacshade/{sensor_id}/health")
            return json.loads(payloads[-1]) if payloads else {"frames": {"captured": 0}}

        wait_until(lambda: health("left")["frames"]["captured"] > 10, 30, "the first works")
        failed = health("left")["frames"]["failed"]  # before it was connected
        second_id = "left" if same_id else "right"
        folder, device = "one" if same_folder else "two", devices[0 if same_port else 1]
        second = stack.enter_context(Daemon(tmp_path, "second", broker.port, second_id, folder, device))
        holder = f"process {first.process.pid}"
        wait_until(lambda: second.said(f"c.reference.npz: in use by 'sensor left, {holder}'"), 30, "reference")
        if same_id:
            place = f"on {socket.gethostname()}, {holder}"
            wait_until(lambda: second.said(f"another daemon, {place}, is using tacshade/left; waiting"), 30, "id")
            address = BrokerAddress(host="127.0.0.1", port=broker.port, username=None, password=None, tls_ca=None)
            _, found = check_broker(address, "left")
            finding = judge_daemon(found, Process(first.process.pid, ("tacshade-edge", "run")), "left")
            waiting = f"on {socket.gethostname()}, process {second.process.pid}"
            expected = f"two daemons are using left: one is running {place}, and the other is waiting {waiting}"
            assert finding.found == expected
        else:
            wait_until(lambda: health("right")["frames"]["captured"] > 10, 30, "the second works too")
        if same_folder:
            wait_until(lambda: second.said(f"/one: in use by 'sensor left, {holder}'"), 30, "folder")
        if same_port:
            wait_until(lambda: second.said(f"serial {device}: in use by another program"), 30, "port")
        captured = health("left")["frames"]["captured"]
        wait_until(lambda: health("left")["frames"]["captured"] > captured + 60, 30, "the first goes on")
        told = health("left")
        assert (told["mqtt"]["losses"], told["frames"]["failed"]) == (0, failed)
        for text in ("in use by", "another daemon, on", "connection lost"):
            assert not first.said(text)
        assert second.said("in use by another program") == same_port
        assert second.said("another daemon, on") == same_id
        second.stop()
        first.stop()
        assert set(seen.of("tacshade/left/state")) <= {b"online", b"stopped", b"degraded"}
