"""A client of the broker publishes what no daemon does: each bridge still shows the real sensor, and stays small."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.published_sensor import PublishedSensor, bump, calibration, health
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from tacshade_edge.protocol import messages
from tools.testbed.mqtt_rig import MOSQUITTO, BridgeProcess, Broker
from tools.testbed.patience import stretched, wait_until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.broker,
    pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed"),
]
REAL = "right"
MEMORY_MB_MAX, THREADS_MAX, STOP_S_MAX = 400.0, 40, 2.0
NAMES = 1000
NUMBERS = ("0", "-1", "1e-300", "1e308", "1e999", "1" + "0" * 400, "null", '"x"', "[]")
NO_JSON = (b"{", b"[]", b"\xff", b"[" * 60_000, b"{}", b"0")
INFO = messages.encode_info(version="0", config_digest="0", profile="fast", calibration=calibration())


def hostile_infos() -> Iterator[bytes]:
    """Geometries that no sensor has."""
    info = json.loads(INFO)
    for key in ("radius_px", "skin_radius_mm", "visible_half_angle_deg", "row_c", "camera_distance_mm"):
        for number in NUMBERS:
            changed = {**info, "geometry": {**info["geometry"], key: "?"}}
            yield json.dumps(changed).replace('"?"', number).encode()
    yield json.dumps({**info, "geometry": {**info["geometry"], "flange_T_sensor": [0.0] * 7}}).encode()
    yield from NO_JSON


def hostile_healths() -> Iterator[bytes]:
    """Numbers, names and amounts that no daemon reports."""
    reported = json.loads(health())
    for key in ("uptime_s", "capture_fps", "source_dropped"):
        for number in NUMBERS[1:]:
            yield json.dumps({**reported, key: "?"}).replace('"?"', number).encode()
    yield json.dumps({**reported, "frames": {'a"} 1\nforged{x="': 1}}).encode()
    yield json.dumps({**reported, "frames": {f"k{number}": number for number in range(1_000_000)}}).encode()  # 17 MB
    yield from NO_JSON


def is_seen(bridge: BridgeProcess, sensor: PublishedSensor) -> bool:
    """Whether the bridge shows the real sensor to a new reader."""
    with contextlib.suppress(OSError, WebSocketException):
        if bridge.url.startswith("http"):
            sensor.publish("health", health())
            return f'tacshade_up{{sensor="{REAL}"}} 1.0' in bridge.page()
        viewer = connect(bridge.url, subprotocols=[Subprotocol("foxglove.sdk.v1")], max_size=None, compression=None)
        with viewer, contextlib.suppress(TimeoutError):
            for number in range(500):
                sensor.show(bump(number, 1.0, 236.0, 328.0, 8))
                reported = viewer.recv(timeout=1.0)
                if isinstance(reported, bytes):
                    return True
                wanted = [one for one in json.loads(reported).get("channels", ()) if f"/{REAL}/height" in one["topic"]]
                if wanted:
                    asked = [{"id": one["id"], "channelId": one["id"]} for one in wanted]
                    viewer.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
    return False


@pytest.mark.parametrize(
    ("kind", "attack", "logged"),
    [
        ("prometheus", "bad messages", r"bad\d+: health: "),
        ("prometheus", "invented names", r": ignoring this sensor: \d+ are already"),
        ("foxglove", "bad messages", r"bad\d+: info: "),
        ("foxglove", "invented names", r": ignoring this sensor: \d+ are already"),
    ],
)
def test_the_real_sensor_is_shown_and_the_bridge_stays_small(
    tmp_path: Path, kind: str, attack: str, logged: str
) -> None:
    """Half of the bad messages and all names are there, retained, before the bridge and the sensor."""
    topic, bad = ("health", hostile_healths) if kind == "prometheus" else ("info", hostile_infos)
    with Broker(tmp_path) as broker, PublishedSensor(broker.port, "bad") as attacker:

        def publish(first: int) -> None:
            sent = [INFO if topic == "info" else b""] * NAMES if attack == "invented names" else list(bad())[first::2]
            for number, payload in enumerate(sent):
                attacker.base = f"tacshade/bad{number}"
                if payload:
                    attacker.publish(topic, payload, retain=first == 0)
                else:
                    attacker.publish("state", b"online", retain=True)

        publish(0)
        bridge = BridgeProcess(kind, broker.port, tmp_path / "log")
        with PublishedSensor(broker.port, REAL) as sensor, bridge:
            wait_until(lambda: is_seen(bridge, sensor), 30, f"the sensor before, in {bridge.log()[-300:]!r}")
            publish(1)
            wait_until(lambda: is_seen(bridge, sensor), 30, f"the sensor after, in {bridge.log()[-300:]!r}")
            wait_until(lambda: re.search(logged, bridge.log()), 30, f"{logged} in {bridge.log()[-300:]!r}")
            assert bridge.peak_mb() < MEMORY_MB_MAX
            assert bridge.threads() <= THREADS_MAX
            assert bridge.stopped_s() < stretched(STOP_S_MAX)
            assert "Traceback" not in bridge.log()
