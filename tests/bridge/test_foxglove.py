"""The bridge as a viewer meets it: another's WebSocket client, Foxglove's published schemas, a real broker."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from support.published_sensor import CRC, PublishedSensor, bump

from tacshade_edge.protocol import messages, wire
from tacshade_edge.protocol.wire import HeightMessage
from tacshade_edge.types import F64, Pose, Touch
from tools.testbed.mqtt_rig import MOSQUITTO, BridgeProcess, Broker
from tools.testbed.patience import patience

pytest.importorskip("foxglove", reason="the extra foxglove is not installed")
pytest.importorskip("foxglove_schemas_protobuf", reason="Foxglove's published schemas are not installed")
websockets = pytest.importorskip("websockets.asyncio.client", reason="the extra dashboard is not installed")

pytestmark = [
    pytest.mark.broker,
    pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed"),
]


class Viewer:
    """Foxglove's WebSocket protocol as its specification has it; decodes with the schemas that Foxglove publishes."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self.channels: dict[str, dict[str, Any]] = {}
        self._topics: dict[int, str] = {}

    async def _receive(self) -> str | bytes:
        """One message of the socket; what it says of channels is noted.

        The library tells of a channel just before it takes subscriptions to it: one refused so is asked for again.
        """
        if isinstance(data := await self._socket.recv(), str):
            told = json.loads(data)
            for channel in told.get("channels", ()):
                self.channels[channel["topic"]] = channel
            if unknown := re.fullmatch(r"Unknown channel ID: (\d+)", told.get("message", "")):
                await self._ask_for([int(unknown[1])])
        return data

    async def message(self) -> tuple[str, Any]:
        """The next message of a channel that is subscribed to, with its topic."""
        while isinstance(data := await self._receive(), str):
            pass
        opcode, subscription, _log_time_ns = struct.unpack_from("<BIQ", data)
        assert opcode == 1
        topic = self._topics[subscription]
        return topic, self._decode(topic, data[13:])

    async def until(self, *names: str, found: Callable[[Any], bool] = lambda _: True) -> list[Any]:
        """The first message of each of these channels that is it."""
        got: dict[str, Any] = {}
        while len(got) < len(names):
            topic, message = await self.message()
            name = topic.removeprefix("/tacshade/drawn/")
            if name in names and found(message):
                got.setdefault(name, message)
        return [got[name] for name in names]

    async def subscribe(self, *topics: str) -> None:
        while not self.channels.keys() >= set(topics):
            await self._receive()
        ids = [self.channels[topic]["id"] for topic in topics]
        self._topics |= dict(zip(ids, topics, strict=True))
        await self._ask_for(ids)

    async def _ask_for(self, ids: list[int]) -> None:
        subscriptions = [{"id": number, "channelId": number} for number in ids]
        await self._socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))

    async def unsubscribe(self, *topics: str) -> None:
        ids = [self.channels[topic]["id"] for topic in topics]
        await self._socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": ids}))

    def _decode(self, topic: str, data: bytes) -> Any:
        channel = self.channels[topic]
        if channel["encoding"] == "json":
            return json.loads(data)
        kind = channel["schemaName"].removeprefix("foxglove.")
        module = __import__(f"foxglove_schemas_protobuf.{kind}_pb2", fromlist=[kind])
        return getattr(module, kind).FromString(data)


class Asker:
    """Tells whether anybody subscribes to a topic: an MQTT 5 broker answers so."""

    def __init__(self, port: int) -> None:
        self._codes: SimpleQueue[int] = SimpleQueue()
        self._client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        self._client.on_publish = lambda _c, _u, _mid, code, _p: self._codes.put(code.value)
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()

    def heard(self, topic: str) -> bool:
        self._client.publish(topic, b"", 1)
        return self._codes.get(timeout=patience(10)) == 0

    def stop(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


@contextmanager
def bridged(folder: Path, *words: str) -> Iterator[tuple[str, PublishedSensor, Asker]]:
    """A bridge as its users run it, for a broker with one sensor; its address."""
    with Broker(folder) as broker, PublishedSensor(broker.port) as sensor:
        command = [sys.executable, "-m", "tacshade_edge", "bridge", "foxglove", "--broker", f"127.0.0.1:{broker.port}"]
        child = subprocess.Popen([*command, "--listen", "127.0.0.1:0", *words], stdout=subprocess.PIPE, text=True)
        asker = Asker(broker.port)
        try:
            assert child.stdout is not None
            found = re.search(r"ws://\S+", child.stdout.readline())
            assert found
            yield found[0], sensor, asker
            child.send_signal(signal.SIGTERM)
            assert child.wait(patience(10)) == 0
        finally:
            asker.stop()
            child.kill()
            child.communicate()


@asynccontextmanager
async def viewer(url: str) -> AsyncIterator[Viewer]:
    async with (
        asyncio.timeout(patience(30)),
        websockets.connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket,
    ):
        yield Viewer(socket)


async def until(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(patience(10)):
        while not true():
            await asyncio.sleep(0.02)


def test_a_viewer_sees_a_press(tmp_path: Path) -> None:
    press = bump(7, 2.0, 236.0, 328.0, step_px=4)
    later = replace(press, t_ns=press.t_ns + 10**9)  # not too soon for a mesh
    pose = Pose(press.t_ns, 100.0, -20.0, 300.0, 0.5, 0.5, 0.5, 0.5)

    async def watch(url: str, sensor: PublishedSensor, asker: Asker) -> None:
        async with viewer(url) as seen:
            await seen.subscribe("/tacshade/drawn/tf", "/tacshade/drawn/skin")
            rest, placed = await seen.until("skin", "tf")  # before any touch
            points_mm = vertices_mm(rest)
            assert len(points_mm) > 500
            np.testing.assert_allclose(np.linalg.norm(points_mm, axis=1), 20.0, atol=1e-3)
            assert volume_mm3(rest) > 0  # its triangles face outwards
            (fixed,) = placed.transforms
            assert (fixed.parent_frame_id, fixed.child_frame_id) == ("drawn/flange", "drawn/sensor")
            streams = ("height", "cloud", "contact", "touch")
            await seen.subscribe(*(f"/tacshade/drawn/{name}" for name in (*streams, "log")), "/tacshade/bridge")
            await until(lambda: all(asker.heard(f"tacshade/drawn/{name}") for name in streams))
            sensor.publish("state", b"degraded")
            await seen.until(
                "log", found=lambda line: (line.name, line.message) == ("tacshade/drawn/state", "degraded")
            )
            height = wire.encode_height(press, calibration_crc32=CRC, pose=pose, pose_error_us=9)
            sensor.publish("height", height)
            sensor.publish("cloud", wire.encode_cloud(press, calibration_crc32=CRC))
            contact = messages.encode_contact(press, fps=30.0)
            sensor.publish("contact", contact)
            touch = messages.encode_touch(replace(press, touch=Touch({"twist_deg": -2.5}, {"twist_deg": 0.5})))
            sensor.publish("touch", b'{"seq":7,"t_ns":0,"touch":{"twist_deg":1e300},"touch_sigma":{"twist_deg":0.5}}')
            sensor.publish("touch", touch)
            image, cloud, told, numbers = await seen.until(*streams)
            expected = wire.decode(height)
            assert isinstance(expected, HeightMessage)
            assert (image.encoding, image.frame_id) == ("32FC1", "drawn/sensor")
            assert (image.height, image.width, image.step) == (120, 160, 640)
            assert image.timestamp.ToNanoseconds() == press.wall_ns
            np.testing.assert_array_equal(np.frombuffer(image.data, "<f4").reshape(120, 160), expected.height_mm)
            assert [(f.name, f.offset) for f in cloud.fields] == [("x", 0), ("y", 4), ("z", 8), ("object", 12)]
            points = np.frombuffer(cloud.data, [("xyz", "<f4", 3), ("object", "<u2")])
            np.testing.assert_allclose(points["xyz"], press.cloud.points_mm / 1000, rtol=1e-6)
            np.testing.assert_array_equal(points["object"], press.cloud.labels)
            sensor.publish("height", height)  # what came with the first was read above
            (robot,) = await seen.until("tf", found=lambda tf: tf.transforms[0].parent_frame_id == "drawn/base")
            (moved,) = robot.transforms
            assert moved.child_frame_id == "drawn/flange"
            assert (moved.translation.x, moved.translation.y, moved.translation.z) == (0.1, -0.02, 0.3)
            sensor.publish("height", wire.encode_height(later, calibration_crc32=CRC))
            (pressed,) = await seen.until("skin", found=lambda skin: least_radius_mm(skin) < 19)
            assert least_radius_mm(pressed) == pytest.approx(18.0, abs=0.05)  # its corners lie beside the deepest point
            assert told == json.loads(contact)
            assert numbers == json.loads(touch)
            sensor.base = "tacshade/no sensor"
            sensor.publish("state", b"online")
            await seen.until("/tacshade/bridge", found=lambda it: (it["undecodable"], it["unknown_topic"]) == (1, 1))

    with bridged(tmp_path) as (url, sensor, asker):
        asyncio.run(watch(url, sensor, asker))


def test_only_what_is_watched_is_asked_for(tmp_path: Path) -> None:
    def heard() -> set[str]:
        names = ("height", "cloud", "contact", "preview", "map/cloud", "health", "event/slip")
        return {name for name in names if asker.heard(f"tacshade/drawn/{name}")}

    async def watch(url: str) -> None:
        async with viewer(url) as first:
            await first.subscribe("/tacshade/drawn/contact")
            await until(lambda: heard() == {"contact"})
            async with viewer(url) as second:
                await second.subscribe("/tacshade/drawn/skin", "/tacshade/drawn/height", "/tacshade/drawn/contact")
                await until(lambda: heard() == {"contact", "height"})
                await second.unsubscribe("/tacshade/drawn/height")
                await first.unsubscribe("/tacshade/drawn/contact")
            await until(lambda: not heard())  # the second is gone

    with bridged(tmp_path, "--sensor", "drawn") as (url, _, asker):
        assert not heard()
        asyncio.run(watch(url))


def test_it_ends_at_once_with_connections_that_say_nothing(tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        BridgeProcess("foxglove", broker.port, tmp_path / "log") as bridge,
        contextlib.ExitStack() as idle,
    ):
        for _ in range(100):
            idle.enter_context(socket.create_connection(("127.0.0.1", bridge.port), 5))
        assert bridge.threads() < 20
        assert bridge.stopped_s() < patience(4)


def vertices_mm(scene: Any) -> F64:
    return np.array([(p.x, p.y, p.z) for p in scene.entities[0].triangles[0].points]) * 1000


def least_radius_mm(scene: Any) -> float:
    return float(np.linalg.norm(vertices_mm(scene), axis=1).min())


def volume_mm3(scene: Any) -> float:
    """Signed, between the mesh and the origin."""
    corners = vertices_mm(scene)[np.array(scene.entities[0].triangles[0].indices).reshape(-1, 3)]
    return float(np.linalg.det(corners).sum() / 6)
