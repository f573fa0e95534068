"""The daemon on a stand-in for a Raspberry Pi's camera program: its picture, its end, and the next one."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support import rpicam_vid

from tacshade_edge.daemon.app import App
from tacshade_edge.factories import calibrations, sources
from tacshade_edge.reasons import Reason
from tacshade_edge.settings import load
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.patience import patience, wait_until

pytestmark = [pytest.mark.broker, pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")]
BASE = "tacshade/tacshade"
HALVES = np.kron([[40, 200]], np.ones((480, 320))).astype(np.uint8)


def programs() -> list[int]:
    """The stand-ins that this process started."""
    told = subprocess.run(
        ("pgrep", "-P", str(os.getpid()), "-f", rpicam_vid.__file__), capture_output=True, check=False
    )
    return [int(word) for word in told.stdout.split()]


def test_its_program_is_started_again_and_ends_with_the_daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rpicam_vid.put_on_path(tmp_path, monkeypatch)
    np.save(tmp_path / "frames.npy", HALVES[None])
    monkeypatch.setenv("STAND_IN", json.dumps({"frames": str(tmp_path / "frames.npy")}))
    with Broker(tmp_path) as broker, Subscriber(broker.port) as seen:
        path = tmp_path / "settings.yaml"
        path.write_text(
            f"calibration: c.npz\nsource: {{kind: rpicam, fps: 60}}\nmqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
        )
        document = load(path)
        missing = calibrations.find_calibration(document)
        assert isinstance(missing, Reason)
        app = App(document, sources.make_source(document.settings.source), missing)
        thread = threading.Thread(target=app.run)
        thread.start()

        def told() -> list[dict[str, Any]]:
            return [json.loads(payload) for payload in seen.of(f"{BASE}/status/camera")]

        try:
            picture = cv2.imdecode(np.frombuffer(seen.wait_for(f"{BASE}/preview", 1, 10)[0], np.uint8), 0)
            assert abs(int(picture[0, 0]) - 40) + abs(int(picture[-1, -1]) - 200) < 8
            wait_until(lambda: bool(told()), 10, "the camera is told")
            (first,) = programs()
            os.kill(first, signal.SIGKILL)
            wait_until(lambda: any(state.get("reason_code") == "lost" for state in told()), 10, "its end is told")
            wait_until(lambda: programs() not in ([], [first]), 10, "another is started")
            wait_until(lambda: told()[-1].get("exposure_lock") == "locked", 10, "frames again")
        finally:
            app.stop()
            thread.join(patience(10))
    assert programs() == []
