"""The daemon with a robot: poses in height maps, commands, what is published of the line."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tacshade_edge.daemon.app import App
from tacshade_edge.protocol import wire
from tacshade_edge.settings import load
from tacshade_edge.storage.tables.frame_table import read_table
from tacshade_edge.types import Calibration
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.patience import patience, wait_until
from tools.testbed.robot import PtyRobot, motion

pytestmark = [pytest.mark.broker, pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")]
BASE = "tacshade/hand-1"


def stream(pictures: Any, touched: threading.Event) -> Iterator[Any]:
    pause = threading.Event()
    while True:
        yield pictures.touched if touched.is_set() else pictures.free
        yield lambda: pause.wait(0.02)


def test_poses_and_commands_from_the_line_to_a_subscriber(
    tmp_path: Path, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    link = Path(f"/dev/shm/tacshade-app-{os.getpid()}")
    path = tmp_path / "settings.yaml"
    touched = threading.Event()
    with (
        Broker(tmp_path) as broker,
        Subscriber(broker.port) as seen,
        PtyRobot(link, rate_hz=200, binary=True) as robot,
    ):
        path.write_text(
            f"sensor_id: hand-1\nsource: {{kind: simulated}}\nmqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
            f"serial: {{device: {link}}}\nrecorder: {{folder: recs}}\n"
        )
        app = App(load(path), scripted(stream(pictures, touched)), calibration)
        thread = threading.Thread(target=app.run)
        thread.start()
        try:

            def last(topic: str) -> Any:
                payloads = seen.of(f"{BASE}/{topic}")
                return json.loads(payloads[-1]) if payloads else {}

            wait_until(lambda: last("status/serial").get("sync") == "two-way", 15, "synchronised")
            status = last("status/serial")
            assert (status["state"], status["reason"], status["mode"]) == ("connected", "", "BIN")
            assert status["device"] == str(link)

            def answer(text: str) -> str:
                before = len(robot.answers)
                robot.ask(text)
                wait_until(lambda: robot.answers[before:], 15, f"an answer to {text}")
                return robot.answers[before]

            assert "frames=10 calibration_crc32=" in answer("REFERENCE")
            assert "camera=streaming fps=" in answer("STATUS")
            touched.set()
            wait_until(lambda: any(wire.decode(p).pose for p in seen.of(f"{BASE}/height")), 10, "a pose")
            assert " contact=1 depth_mm=" in answer("CAPTURE")
            refused = answer("REFERENCE")
            assert refused.startswith("ERR")
            assert "found a contact" in refused
            heights = [message for p in seen.of(f"{BASE}/height") if (message := wire.decode(p)).pose]
            for message in heights:
                assert message.pose is not None
                truth = motion(message.t_ns / 1e9 - robot.began_s)
                slack_mm = 63 * (message.pose_error_us / 1e6 + 1e-4) + 0.02
                assert (message.pose.x_mm, message.pose.y_mm) == pytest.approx(truth[:2], abs=slack_mm)
                assert 0 < message.pose_error_us < 100_000
            request = {"action": "start", "seconds": 60, "name": "r"}
            seen.publish(f"{BASE}/req/record", json.dumps(request).encode())
            wait_until(lambda: last("status/recorder").get("frames", 0) > 10, 15, "a recording")
            seen.publish(f"{BASE}/req/record", b'{"action": "stop"}')
            wait_until(lambda: last("status/recorder").get("state") == "idle", 10, "its end")
            rows = [row for row in read_table(tmp_path / "recs" / "r" / "frames.csv") if row.pose]
            assert rows
            for row in rows:
                assert row.pose is not None
                truth = motion(row.t_ns / 1e9 - robot.began_s)
                assert (row.pose.x_mm, row.pose.y_mm) == pytest.approx(truth[:2], abs=0.3)
            wait_until(lambda: last("health").get("serial", {}).get("frames_with_pose", 0) > 0, 10, "health")
            robot.unplug()
            wait_until(lambda: last("status/serial")["state"] == "away", 10, "away")
            robot.plug()
            wait_until(lambda: last("status/serial")["state"] == "connected", 10, "connected")
        finally:
            app.stop()
            thread.join(patience(10))
        assert not thread.is_alive()
    link.unlink(missing_ok=True)
