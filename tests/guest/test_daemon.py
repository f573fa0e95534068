"""The daemon on a real video device: `run` as its users run it, mosquitto and a subscriber beside it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.handed_in import PAINTED
from support.vivid import NODE, WEBCAM, control, kept_fps, load_driver, unload_driver

from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.patience import patience, stretched, wait_until

TREE = Path(__file__).resolve().parents[2]
BASE = "tacshade/tacshade"
START_S = 10


@contextmanager
def running(folder: Path, fps: int) -> Iterator[tuple[subprocess.Popen[str], Subscriber]]:
    """`tacshade-edge run` on the camera, until SIGTERM ends it well."""
    config = folder / "settings.yaml"
    with Broker(folder) as broker, Subscriber(broker.port) as seen:
        config.write_text(
            f"calibration: {PAINTED}/calibration.npz\n"
            f"source: {{kind: v4l2, device: {NODE}, width_px: 640, height_px: 480, fps: {fps}, fourcc: YUYV}}\n"
            f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
        )
        command = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(config)]
        child = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        try:
            wait_until(lambda: camera(seen).get("state") == "streaming", START_S, "the camera streams")
            yield child, seen
            child.send_signal(signal.SIGTERM)
            _, errors = child.communicate(timeout=patience(10))
            assert child.returncode == 0, errors
            assert seen.wait_for(f"{BASE}/state")[-1] == b"stopped"
        finally:
            child.kill()
            print(child.communicate()[1])


def camera(seen: Subscriber) -> Any:
    return json.loads((seen.of(f"{BASE}/status/camera") or [b"{}"])[-1])


def captured(seen: Subscriber) -> int:
    return int(json.loads((seen.of(f"{BASE}/health") or [b'{"frames": {"captured": 0}}'])[-1])["frames"]["captured"])


@pytest.fixture(autouse=True)
def no_driver_left() -> Iterator[None]:
    yield
    unload_driver()


def test_replugged_camera_streams_within_two_seconds(tmp_path: Path) -> None:
    load_driver(*WEBCAM)
    with running(tmp_path, kept_fps()) as (child, seen):
        keeper = os.open(NODE, os.O_RDWR)  # the driver takes a disconnect back when its last user has gone
        control("disconnect=1")
        wait_until(lambda: camera(seen)["state"] == "away", 5, "the daemon says that the camera is away")
        assert NODE in camera(seen)["reason"]
        Path(NODE).unlink()  # a real unplug does this, and the daemon must not take hold of it again
        os.close(keeper)
        unload_driver()
        threading.Event().wait(3)  # unplugged for longer than the longest pause between attempts
        before = captured(seen)
        plug = threading.Thread(target=load_driver, args=WEBCAM)
        plug.start()
        wait_until(Path(NODE).exists, 10, "the node is back")
        there_s = time.monotonic()
        wait_until(lambda: camera(seen)["state"] == "streaming", 10, "frames are back")
        took_s = time.monotonic() - there_s
        plug.join()
        wait_until(lambda: captured(seen) > before + 10, 10, "frames go on")
        print(f"streaming {took_s:.2f} s after the node was back")
        assert took_s < stretched(2)
        assert child.poll() is None, "the same process"
