"""A hand as its users run it: the command, a real broker, and what becomes of the others when one part ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest

from tacshade_edge.protocol.topics import HandObjects, decode_hand
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration
from tools.testbed.patience import patience, wait_until

pytestmark = [
    pytest.mark.broker,
    pytest.mark.slow,
    pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed"),
]
BASE = "tacshade/hand/left"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two fingers that see the same press again and again."""
    for name in ("thumb", "index"):
        calibration_file.save(tmp_path / f"{name}.npz", painted_calibration())
        (tmp_path / name).mkdir()
        for i, image in enumerate([FREE] * 3 + [TOUCHED] * 20):
            cv2.imwrite(str(tmp_path / name / f"{i:02d}.png"), image)
    return tmp_path


@pytest.fixture
def broker(folder: Path) -> Iterator[Broker]:
    with Broker(folder) as made:
        yield made


@pytest.fixture
def running(folder: Path, broker: Broker) -> Iterator[subprocess.Popen[bytes]]:
    # The index is turned by a quarter about z, from x towards y.
    text = f"""\
hand_id: left
mqtt: {{host: 127.0.0.1, port: {broker.port}}}
recorder: {{folder: recs}}
stitching: {{folder: maps}}
sensors:
  thumb: {{calibration: thumb.npz, source: {{kind: files, path: thumb, fps: 60, loop: true}}, {at("100, 0, 0, 1, 0")}}}
  index: {{calibration: index.npz, source: {{kind: files, path: index, fps: 60, loop: true}}, {at("0, 0, 0, 1, 1")}}}
"""
    config = folder / "hand.yaml"
    config.write_text(text)
    command = (sys.executable, "-m", "tacshade_edge", "run", "--config", str(config))
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(command, stderr=log, stdin=subprocess.DEVNULL)
    yield process
    process.kill()
    process.wait()


def at(place: str) -> str:
    """``hand_T_sensor`` of x, y, z and the unnormalised w and z of a turn about z."""
    *xyz, w, z = map(float, place.split(","))
    long = (w * w + z * z) ** 0.5
    return f"hand_T_sensor: {[*xyz, round(w / long, 6), 0.0, 0.0, round(z / long, 6)]}"


def latest(seen: Subscriber) -> HandObjects | None:
    payloads = seen.of(f"{BASE}/objects")
    return decode_hand(payloads[-1]) if payloads else None


def states(seen: Subscriber) -> dict[str, str]:
    hand = latest(seen)
    return {name: finger.state for name, finger in hand.fingers.items()} if hand else {}


def told(seen: Subscriber, topic: str) -> Any:
    payloads = seen.of(topic)
    return json.loads(payloads[-1]) if payloads else {}


def both_touch(seen: Subscriber) -> bool:
    return set(states(seen).values()) == {"contact"}


def test_objects_of_both_fingers_come_in_the_hands_frame_and_no_part_needs_another(
    broker: Broker, running: subprocess.Popen[bytes], folder: Path
) -> None:
    # Nobody listens to what a finger sees.
    with Subscriber(broker.port, f"{BASE}/+") as seen, Subscriber(broker.port, "tacshade/+/state") as fingers:
        fingers.client.subscribe([("tacshade/+/health", 1), ("tacshade/+/info", 1)])
        wait_until(lambda: both_touch(seen), 30, "both fingers touch")
        hand = latest(seen)
        assert hand is not None
        (thumb, *_), (index, *_) = (hand.fingers[name].objects for name in ("thumb", "index"))
        x_mm, y_mm, z_mm = thumb.centroid_mm
        assert index.centroid_mm == pytest.approx((-y_mm, x_mm - 100, z_mm), abs=1e-3)
        assert index.depth_max_mm == thumb.depth_max_mm > 0
        assert all(finger.age_ms is not None and finger.age_ms < 1000 for finger in hand.fingers.values())
        wait_until(lambda: told(fingers, "tacshade/thumb/info"), 10, "where the thumb is")
        info = told(fingers, "tacshade/thumb/info")
        assert (info["hand_id"], info["hand_T_sensor"]) == ("left", [100.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])

        # A reload moves the thumb, from the next frame on.
        config = folder / "hand.yaml"
        config.write_text(config.read_text().replace("[100.0, 0.0, 0.0,", "[100.0, 0.0, 50.0,"))
        running.send_signal(signal.SIGHUP)
        wait_until(lambda: told(fingers, "tacshade/thumb/info")["hand_T_sensor"][2] == 50, 20, "its new place is told")
        wait_until(lambda: thumb_z_mm(seen) == pytest.approx(z_mm + 50, abs=0.5), 20, "and used")

        # The hand's own process ends: the sensors never leave the broker, and it comes back.
        left = {name: len(fingers.of(f"tacshade/{name}/state")) for name in ("thumb", "index")}
        first = told(seen, f"{BASE}/instance")
        os.kill(first["process"], signal.SIGKILL)
        wait_until(lambda: told(seen, f"{BASE}/instance")["id"] != first["id"], 20, "started again")
        count = len(seen.of(f"{BASE}/objects"))
        wait_until(lambda: len(seen.of(f"{BASE}/objects")) > count and both_touch(seen), 20, "both touch again")
        assert {name: len(fingers.of(f"tacshade/{name}/state")) for name in left} == left

        # A sensor's process ends: it is told at once, the other finger goes on.
        count = len(seen.of(f"{BASE}/objects"))
        os.kill(told_pid(broker, "thumb"), signal.SIGKILL)
        wait_until(
            lambda: any(
                decode_hand(p).fingers["thumb"].reason_code == "daemon_stopped"
                for p in seen.of(f"{BASE}/objects")[count:]
            ),
            10,
            "the hand tells that a finger is away",
        )
        wait_until(lambda: both_touch(seen), 20, "both touch again")
        assert len(fingers.of("tacshade/index/state")) == left["index"]
        frames = told(fingers, "tacshade/index/health")["frames"]
        assert frames["captured"] == sum(n for key, n in frames.items() if key != "captured")

        running.send_signal(signal.SIGTERM)
        assert running.wait(patience(10)) == 0
        seen.wait_for_last(f"{BASE}/state", b"stopped")
        health = told(seen, f"{BASE}/health")
        assert health["undecodable"] == 0
        assert all(count > 0 for count in health["heard"].values())
    assert "Traceback" not in (folder / "log").read_text()


def thumb_z_mm(seen: Subscriber) -> float | None:
    hand = latest(seen)
    objects = hand.fingers["thumb"].objects if hand else ()
    return objects[0].centroid_mm[2] if objects else None


def told_pid(broker: Broker, name: str) -> int:
    with Subscriber(broker.port, f"tacshade/{name}/instance") as seen:
        return int(json.loads(seen.wait_for(f"tacshade/{name}/instance")[-1])["process"])


def test_nobody_listens_and_no_depth_is_computed(broker: Broker, running: subprocess.Popen[bytes]) -> None:
    with Subscriber(broker.port, "tacshade/thumb/health") as seen:
        wait_until(lambda: frames_of(seen).get("unasked", 0) > 60, 30, "frames in contact that nobody asked for")
        frames = frames_of(seen)
        assert frames["published"] < 0.2 * frames["unasked"]
    running.send_signal(signal.SIGTERM)
    assert running.wait(patience(10)) == 0


def frames_of(seen: Subscriber) -> dict[str, int]:
    return dict(told(seen, "tacshade/thumb/health").get("frames", {}))
