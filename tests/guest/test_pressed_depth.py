"""The main job on a real video device: a simulated sensor's presses, played into it, decoded by a subscriber."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.handed_in import IMAGES_A_PRESS, PRESSED, facts
from support.vivid import NODE, unload_driver

from tacshade_edge.protocol import wire
from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.patience import patience, slowness, wait_until

TREE = Path(__file__).resolve().parents[2]
BASE = "tacshade/finger"
DEPTH_RATIO = 0.25
LEAST = 3  # messages of each press
FRAME_S = 0.012
"""What the daemon takes for one where nothing is emulated, all copies and messages counted; measured with a margin."""


def test_decoded_depth_is_the_pressed_depth(tmp_path: Path) -> None:
    """Calibrated on 20 ball presses, ball and cube are played into the camera and decoded at a subscriber."""
    known = facts(PRESSED)
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
        heights, clouds = _run_daemon(tmp_path, {name: press["x_mm"] for name, press in known.items()})
        player.terminate()
    unload_driver()
    for name, press in known.items():
        decoded = _depths(heights, clouds, press["x_mm"])
        found_mm = float(np.median(decoded))
        print(f"{name}: pressed {press['depth_mm']:.2f} mm, decoded {found_mm:.2f} mm from {len(decoded)} messages")
        assert found_mm == pytest.approx(press["depth_mm"], rel=DEPTH_RATIO)
    assert any(not h.contact and np.nanmax(h.height_mm) == 0 for h in heights), "the release is a zero map"


def _depths(heights: list[wire.HeightMessage], clouds: list[wire.CloudMessage], x_mm: float) -> list[float]:
    """The greatest depths of the maps whose cloud lies at a press."""
    near = {c.seq for c in clouds if len(c.points_mm) and abs(np.mean(c.points_mm, axis=0)[0] - x_mm) < 2.5}
    return [float(np.nanmax(h.height_mm)) for h in heights if h.seq in near]


def _run_daemon(folder: Path, x_mm: dict[str, float]) -> tuple[list[wire.HeightMessage], list[wire.CloudMessage]]:
    """All that a subscriber has when there is enough of each press and of a release."""
    shutil.copy(PRESSED / "calibration.npz", folder)
    config = folder / "settings.yaml"
    heights: list[wire.HeightMessage] = []
    clouds: list[wire.CloudMessage] = []

    def enough(seen: Subscriber) -> bool:
        for topic, kept in (("height", heights), ("cloud", clouds)):
            kept += map(wire.decode, seen.of(f"{BASE}/{topic}")[len(kept) :])  # type: ignore[arg-type]
        released = any(not h.contact for h in heights)
        return released and all(len(_depths(heights, clouds, x)) >= LEAST for x in x_mm.values())

    with Broker(folder) as broker, Subscriber(broker.port) as seen:
        config.write_text(
            "sensor_id: finger\ncalibration: calibration.npz\nprofile: fast\n"
            f"source: {{kind: v4l2, device: {NODE}, width_px: 640, height_px: 480, fps: 25, fourcc: YUYV}}\n"
            f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
        )
        command = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(config)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as daemon:
            try:
                wait_until(lambda: enough(seen), 20, "each press is seen, and a release")
                daemon.send_signal(signal.SIGTERM)
                _, errors = daemon.communicate(timeout=patience(10))
                assert daemon.returncode == 0, errors
            finally:
                daemon.kill()
    return heights, clouds
