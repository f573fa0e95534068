"""The main job on a real video device: a simulated sensor's presses, calibrated, decoded by a subscriber."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mqtt_rig import Broker, Subscriber, wait_until
from vivid import NODE, unload_driver

from tacshade_edge.core.greyscale import to_grey
from tacshade_edge.protocol import wire
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedSensor

TREE = Path(__file__).resolve().parents[2]
BASE = "tacshade/hand"
PRESSES = [
    Press(OBJECTS["ball"](), -2.5, 0.0, 3.0),
    Press(OBJECTS["cube"](), 2.5, 0.0, 3.0),
]
DEPTH_RATIO = 0.25
IMAGES_A_PRESS, RATE = 10, 4  # the emulated CPU is slow


def tacshade_edge(*arguments: str | Path) -> str:
    command = [sys.executable, "-m", "tacshade_edge", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_decoded_depth_is_the_pressed_depth(tmp_path: Path) -> None:
    """Calibrate on 20 ball presses by the command line, play ball and cube into the camera, decode at a subscriber."""
    tacshade_edge("simulate", "--calibration-set", tmp_path / "set", "--presses", "20", "--seed", "3")
    references = sorted((tmp_path / "set").glob("reference_*.png"))
    sensor_yaml, presses_csv = tmp_path / "set/SENSOR.yaml", tmp_path / "set/PRESSES.csv"
    tacshade_edge(
        *("calibrate", "--sensor", sensor_yaml, "--presses", presses_csv, "--out", tmp_path / "cal.npz"),
        *("--reference", *references),
    )
    sensor = SimulatedSensor()
    frames = [sensor.frame([press], noise_seed=70 + k) for k, press in enumerate(PRESSES)]
    free = to_grey(sensor.frame((), noise_seed=60).image)
    images = [free] * 6
    for frame in frames:
        images += [to_grey(frame.image)] * IMAGES_A_PRESS + [free] * 6
    np.save(tmp_path / "images.npy", np.stack(images))
    truth_mm = [float(frame.skin.height_mm.max()) for frame in frames]

    feeder = [sys.executable, str(TREE / "tools/rig/feed_video.py"), "--rate", str(RATE), str(tmp_path / "images.npy")]
    with subprocess.Popen(feeder, stdout=subprocess.PIPE, text=True) as player:
        assert player.stdout is not None
        assert player.stdout.readline() == "playing\n"
        heights, clouds = _run_daemon(tmp_path, wanted=2 * IMAGES_A_PRESS + 10)
        player.terminate()
    unload_driver()

    place_mm = {c.seq: np.mean(c.points_mm, axis=0) for c in clouds if len(c.points_mm)}
    for press, true_mm in zip(PRESSES, truth_mm, strict=True):
        decoded = [
            float(np.nanmax(h.height_mm))
            for h in heights
            if h.seq in place_mm and abs(place_mm[h.seq][0] - press.x_mm) < 2.5
        ]
        assert len(decoded) >= 3, f"{press.shape.name}: few messages"
        found_mm = float(np.median(decoded))
        print(f"{press.shape.name}: pressed {true_mm:.2f} mm, decoded {found_mm:.2f} mm from {len(decoded)} messages")
        assert found_mm == pytest.approx(true_mm, rel=DEPTH_RATIO)
    assert any(not h.contact and np.nanmax(h.height_mm) == 0 for h in heights), "the release is a zero map"


def _run_daemon(folder: Path, wanted: int) -> tuple[list[wire.HeightMessage], list[wire.CloudMessage]]:
    config = folder / "settings.yaml"
    with Broker(folder) as broker, Subscriber(broker.port) as seen:
        config.write_text(
            "sensor_id: hand\ncalibration: cal.npz\nprofile: fast\n"
            f"source: {{kind: v4l2, device: {NODE}, width_px: 640, height_px: 480, fps: 25, fourcc: YUYV}}\n"
            f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
        )
        command = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(config)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as daemon:
            try:
                wait_until(lambda: len(seen.of(f"{BASE}/height")) >= wanted, 120, "heights arrive")
                daemon.send_signal(signal.SIGTERM)
                _, errors = daemon.communicate(timeout=20)
                assert daemon.returncode == 0, errors
            finally:
                daemon.kill()
        health = json.loads(seen.of(f"{BASE}/health")[-1])
        print("stages", json.dumps(health.get("stages_ms", health)))
        decoded = [wire.decode(p) for p in seen.of(f"{BASE}/height") + seen.of(f"{BASE}/cloud")]
    return (
        [m for m in decoded if isinstance(m, wire.HeightMessage)],
        [m for m in decoded if isinstance(m, wire.CloudMessage)],
    )
