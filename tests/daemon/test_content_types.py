"""The MQTT 5 content type of every topic says what its payload is:
the real daemon, broker and frames with poses.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from support.mqtt_rig import Broker, Subscriber
from support.painted_sensor import painted_calibration, write_posed_images
from support.patience import wait_until
from support.running_app import BASE, Live
from tacshade_edge.camera.sources import make_source
from tacshade_edge.errors import DecodeError
from tacshade_edge.settings import load
from tacshade_edge.wire import binary

pytestmark = pytest.mark.broker

STREAMS = {"height", "cloud", "shear", "sigma", "touch", "contact", "preview"}
RETAINED = {"state", "info", "instance", "health", "status/camera", "status/stitching"}
OF_A_SESSION = {"map/revision", "map/cloud", "map/final", "res/stitch"}
KINDS = {
    binary.HeightMessage: "height",
    binary.CloudMessage: "cloud",
    binary.ShearMessage: "shear",
    binary.SigmaMessage: "sigma",
}


def kind_of(payload: bytes) -> str:
    """The content type that a payload should have, from its bytes alone."""
    if payload.startswith(b"\xff\xd8\xff"):
        return "image/jpeg"
    try:
        return f"application/vnd.tacshade.{KINDS[type(binary.decode(payload))]}"
    except DecodeError:
        pass
    try:
        json.loads(payload)
    except ValueError:
        return "text/plain"
    return "application/json"


def test_every_topic_says_what_its_payload_is(tmp_path: Path) -> None:
    write_posed_images(tmp_path / "images")
    with Broker(tmp_path) as broker, Subscriber(broker.port, f"{BASE}/#", v5=True) as seen:
        path = tmp_path / "settings.yaml"
        path.write_text(
            "sensor_id: hand-1\nprofile: fast\ncalibration: c.npz\n"
            "source: {kind: files, path: images, fps: 60, loop: true}\n"
            f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
            "recorder: {folder: recs}\nstitching: {folder: maps}\n"
        )
        settings = load(path)

        def heard() -> set[str]:
            return {message.topic.removeprefix(f"{BASE}/") for message in list(seen.messages)}

        live = Live(tmp_path, broker, seen, painted_calibration())
        running = live.run(make_source(settings.settings.source), settings)
        try:
            wait_until(lambda: heard() >= STREAMS | RETAINED, 30, "streams and retained values")
            assert live.ask("stitch", action="begin")["ok"]
            wait_until(lambda: live.last("status/stitching").get("presses", 0) > 0, 30, "a press")
            assert live.ask("stitch", action="end")["ok"]
            wait_until(lambda: heard() >= OF_A_SESSION, 30, "a map")
        finally:
            running.end()
        seen.wait_for_last(f"{BASE}/state", b"stopped")
        ours = [
            message
            for message in list(seen.messages)
            if not message.topic.startswith(f"{BASE}/req/")
        ]
        wrong = {
            message.topic: (found, expected)
            for message in ours
            if (found := getattr(message.properties, "ContentType", None))
            != (expected := kind_of(message.payload))
        }
    assert wrong == {}
