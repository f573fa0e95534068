"""The main job on a real video device: a simulated sensor's presses, played into it, decoded by a subscriber.

The depth is the true one, and exactly that which the core finds in the image that was played.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.handed_in import IMAGES_A_PRESS, PRESSED, PROFILE, pressed_facts
from support.vivid import NODE, unload_driver

from tacshade_edge.protocol import wire
from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.patience import patience, slowness, wait_until

TREE = Path(__file__).resolve().parents[2]
DECODED = ("tacshade/finger/height", "tacshade/finger/cloud")
DEPTH_RATIO = 0.25
LEAST = 3  # messages of each press
FRAME_S = 0.012
"""What the daemon takes for one where nothing is emulated, all copies and messages counted; measured with a margin."""


def test_decoded_depth_is_the_pressed_depth(tmp_path: Path) -> None:
    """Calibrated on 20 ball presses, ball and cube are played into the camera and decoded at a subscriber."""
    known = pressed_facts()
    # Each press is there for as long as a few frames take: what this machine cannot keep up with shows nothing.
    rate_hz = min(25.0, IMAGES_A_PRESS / (4 * LEAST * FRAME_S * slowness()))
    print(f"{rate_hz:.1f} images a second")
    feeder = [
        sys.executable,
        str(TREE / "tools/rig/feed_video.py"),
        "--rate",
        f"{rate_hz}",
        str(PRESSED / "images.npy"),
    ]
    with subprocess.Popen(feeder, stdout=subprocess.PIPE, text=True) as player:
        assert player.stdout is not None
        assert player.stdout.readline() == "playing\n"
        seen = _run_daemon(tmp_path, [press["x_mm"] for press in known.values()])
        player.terminate()
    unload_driver()
    for name, press in known.items():
        decoded = seen.depths_mm(press["x_mm"])
        found_mm = float(np.median(decoded))
        print(f"{name}: pressed {press['depth_mm']:.2f} mm, decoded {found_mm:.2f} mm from {len(decoded)} messages")
        assert found_mm == pytest.approx(press["depth_mm"], rel=DEPTH_RATIO)
        assert found_mm == pytest.approx(press["found_mm"], abs=0.001)
    assert seen.released, "the release is a zero map"


class _Seen:
    """What a subscriber decoded, each message once: where all is emulated, once more at every look takes too long."""

    def __init__(self, subscriber: Subscriber) -> None:
        self._subscriber = subscriber
        self._read = 0
        self._deepest_mm: dict[int, float] = {}
        self._x_mm: dict[int, float] = {}
        self.released = False

    def look(self) -> None:
        """Decode what has come."""
        new = self._subscriber.messages[self._read :]
        self._read += len(new)
        for payload in (bytes(message.payload) for message in new if message.topic in DECODED):
            message = wire.decode(payload)
            if isinstance(message, wire.HeightMessage):
                self._deepest_mm[message.seq] = float(np.nanmax(message.height_mm))
                self.released |= not message.contact and self._deepest_mm[message.seq] == 0
            elif isinstance(message, wire.CloudMessage) and len(message.points_mm):
                self._x_mm[message.seq] = float(np.mean(message.points_mm, axis=0)[0])

    def depths_mm(self, x_mm: float) -> list[float]:
        """The greatest depths of the maps whose cloud lies at a press."""
        near = {seq for seq, there_mm in self._x_mm.items() if abs(there_mm - x_mm) < 2.5}
        return [deepest_mm for seq, deepest_mm in self._deepest_mm.items() if seq in near]


def _run_daemon(folder: Path, x_mm: list[float]) -> _Seen:
    """All that a subscriber has when there is enough of each press and of a release."""
    shutil.copy(PRESSED / "calibration.npz", folder)
    config = folder / "settings.yaml"
    with Broker(folder) as broker, Subscriber(broker.port) as subscriber:
        seen = _Seen(subscriber)

        def enough() -> bool:
            seen.look()
            return seen.released and all(len(seen.depths_mm(x)) >= LEAST for x in x_mm)

        config.write_text(
            f"sensor_id: finger\ncalibration: calibration.npz\nprofile: {PROFILE}\n"
            f"source: {{kind: v4l2, device: {NODE}, width_px: 640, height_px: 480, fps: 25, fourcc: YUYV}}\n"
            f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
        )
        command = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(config)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as daemon:
            try:
                wait_until(enough, 20, "each press is seen, and a release")
                daemon.send_signal(signal.SIGTERM)
                _, errors = daemon.communicate(timeout=patience(10))
                assert daemon.returncode == 0, errors
            finally:
                daemon.kill()
    return seen
