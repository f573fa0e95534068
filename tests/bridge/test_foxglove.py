"""The bridge as a viewer meets it: another's WebSocket client, Foxglove's published schemas,
hostile sensors.
"""

from __future__ import annotations

import contextlib
import json
import socket
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.mqtt_rig import BridgeProcess, Broker
from support.patience import patience, wait_until
from support.published_sensor import CRC, bump, calibration
from tacshade_edge.types import F64, Pose, Touch
from tacshade_edge.wire import binary, messages

pytest.importorskip("foxglove", reason="the extra foxglove is not installed")
pytest.importorskip(
    "foxglove_schemas_protobuf", reason="Foxglove's published schemas are not installed"
)
client = pytest.importorskip(
    "websockets.sync.client", reason="the extra dashboard is not installed"
)
foxglove = pytest.importorskip("tacshade_edge.bridge.foxglove")
viewers = pytest.importorskip("tacshade_edge.bridge.viewers")

INFO = messages.encode_info(
    version="0", config_digest="0", profile="fast", calibration=calibration()
)
NUMBERS = ("0", "-1", "1e-300", "1e308", "1e999", "1" + "0" * 400, "null", '"x"', "[]")


class Bridge:
    """A bridge that the test feeds with a broker's messages;
    `asked` are the topics that it subscribes to.
    """

    def __init__(self) -> None:
        self.asked: set[str] = set()
        self._bridge = foxglove.FoxgloveBridge("127.0.0.1", 0, [], self._follow)
        self.url = f"ws://127.0.0.1:{self._bridge.port}"
        self.stop = self._bridge.stop

    def _follow(self, topics: set[str]) -> None:
        self.asked = topics

    def hear(self, topic: str, payload: bytes, sensor_id: str = "drawn") -> None:
        self._bridge.hear(f"tacshade/{sensor_id}/{topic}", payload, False)

    def streams(self) -> set[str]:
        """What it asks of the sensor beside `info` and `state`."""
        self._bridge.poll()
        return {topic.removeprefix("tacshade/drawn/") for topic in self.asked if "/drawn/" in topic}


@pytest.fixture
def bridge() -> Iterator[Bridge]:
    made = Bridge()
    made.hear("info", INFO)
    made.hear("state", b"online")
    yield made
    made.stop()


class Viewer:
    """Foxglove's WebSocket protocol as its specification has it;
    decodes with the schemas that Foxglove publishes.
    """

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self.channels: dict[str, dict[str, Any]] = {}

    def _receive(self) -> str | bytes:
        if isinstance(data := self._socket.recv(timeout=patience(10)), str):
            for channel in json.loads(data).get("channels", ()):
                self.channels[channel["topic"].removeprefix("/tacshade/drawn/")] = channel
        assert isinstance(data, str | bytes)
        return data

    def until(self, *names: str, found: Callable[[Any], bool] = lambda _: True) -> list[Any]:
        """The first message of each of these channels that is it."""
        got: dict[str, Any] = {}
        by_id = {channel["id"]: name for name, channel in self.channels.items()}
        while len(got) < len(names):
            if isinstance(data := self._receive(), bytes):
                opcode, subscription, _log_time_ns = struct.unpack_from("<BIQ", data)
                assert opcode == 1
                message = self._decode(name := by_id[subscription], data[13:])
                if name in names and found(message):
                    got.setdefault(name, message)
        return [got[name] for name in names]

    def subscribe(self, *names: str) -> None:
        while not self.channels.keys() >= set(names):
            self._receive()
        ids = [self.channels[name]["id"] for name in names]
        subscriptions = [{"id": number, "channelId": number} for number in ids]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))

    def unsubscribe(self, *names: str) -> None:
        ids = [self.channels[name]["id"] for name in names]
        self._socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": ids}))

    def _decode(self, name: str, data: bytes) -> Any:
        if self.channels[name]["encoding"] == "json":
            return json.loads(data)
        kind = self.channels[name]["schemaName"].removeprefix("foxglove.")
        module = __import__(f"foxglove_schemas_protobuf.{kind}_pb2", fromlist=[kind])
        return getattr(module, kind).FromString(data)


@contextlib.contextmanager
def viewer(url: str, **words: Any) -> Iterator[Viewer]:
    words = {"subprotocols": ["foxglove.sdk.v1"], "max_size": None, "close_timeout": 0.2} | words
    with client.connect(url, **words) as connection:
        yield Viewer(connection)


def test_a_viewer_sees_a_press(bridge: Bridge) -> None:
    press = bump(7, 2.0, 236.0, 328.0, step_px=4)
    later = replace(press, t_ns=press.t_ns + 10**9)  # not too soon for a mesh
    pose = Pose(press.t_ns, 100.0, -20.0, 300.0, 0.5, 0.5, 0.5, 0.5)
    with viewer(bridge.url) as seen:
        seen.subscribe("tf", "skin")
        wait_until(lambda: bridge.streams() >= {"height"}, 10, "watched")
        bridge.hear(
            "height",
            binary.encode_height(bump(6, 0.0, 236.0, 328.0, step_px=4), calibration_crc32=CRC),
        )
        rest, placed = seen.until("skin", "tf")
        points_mm = vertices_mm(rest)
        assert len(points_mm) > 500
        np.testing.assert_allclose(np.linalg.norm(points_mm, axis=1), 20.0, atol=1e-3)
        corners = points_mm[np.array(rest.entities[0].triangles[0].indices).reshape(-1, 3)]
        assert np.linalg.det(corners).sum() > 0, "its triangles face outwards"
        (fixed,) = placed.transforms
        assert (fixed.parent_frame_id, fixed.child_frame_id) == ("drawn/flange", "drawn/sensor")
        streams = ("height", "cloud", "contact", "touch")
        seen.subscribe(*streams, "log", "/tacshade/bridge")
        wait_until(lambda: bridge.streams() >= {*streams, "state"}, 10, "watched")
        bridge.hear("state", b"degraded")
        seen.until(
            "log",
            found=lambda line: (line.name, line.message) == ("tacshade/drawn/state", "degraded"),
        )
        height = binary.encode_height(press, calibration_crc32=CRC, pose=pose, pose_error_us=9)
        contact = messages.encode_contact(press, fps=30.0)
        touch = messages.encode_touch(
            replace(press, touch=Touch({"twist_deg": -2.5}, {"twist_deg": 0.5}))
        )
        bridge.hear("height", height)
        bridge.hear("cloud", binary.encode_cloud(press, calibration_crc32=CRC))
        bridge.hear("contact", contact)
        bridge.hear(
            "touch",
            b'{"seq":7,"t_ns":0,"touch":{"twist_deg":1e300},"touch_sigma":{"twist_deg":0.5}}',
        )
        bridge.hear("touch", touch)
        image, cloud, reported, numbers = seen.until(*streams)
        expected = binary.decode(height)
        assert isinstance(expected, binary.HeightMessage)
        assert (image.encoding, image.frame_id) == ("32FC1", "drawn/sensor")
        assert (image.height, image.width, image.step) == (120, 160, 640)
        assert image.timestamp.ToNanoseconds() == press.wall_ns
        np.testing.assert_array_equal(
            np.frombuffer(image.data, "<f4").reshape(120, 160), expected.height_mm
        )
        assert [(f.name, f.offset) for f in cloud.fields] == [
            ("x", 0),
            ("y", 4),
            ("z", 8),
            ("object", 12),
        ]
        points = np.frombuffer(cloud.data, [("xyz", "<f4", 3), ("object", "<u2")])
        np.testing.assert_allclose(points["xyz"], press.cloud.points_mm / 1000, rtol=1e-6)
        np.testing.assert_array_equal(points["object"], press.cloud.labels)
        assert (reported, numbers) == (json.loads(contact), json.loads(touch))
        bridge.hear("height", height)  # what came with the first was read above
        (robot,) = seen.until(
            "tf", found=lambda tf: tf.transforms[0].parent_frame_id == "drawn/base"
        )
        (moved,) = robot.transforms
        assert (moved.translation.x, moved.translation.y, moved.translation.z) == (0.1, -0.02, 0.3)
        bridge.hear("height", binary.encode_height(later, calibration_crc32=CRC))
        (pressed,) = seen.until("skin", found=lambda skin: least_radius_mm(skin) < 19)
        assert least_radius_mm(pressed) == pytest.approx(
            18.0, abs=0.05
        )  # its corners lie beside the deepest point
        bridge.hear("state", b"online", "no sensor")
        bridge.streams()
        seen.until(
            "/tacshade/bridge", found=lambda it: (it["undecodable"], it["unknown_topic"]) == (1, 1)
        )


def test_only_what_is_watched_is_asked_for(bridge: Bridge) -> None:
    assert bridge.streams() == set()
    with viewer(bridge.url) as first:
        first.subscribe("contact")
        wait_until(lambda: bridge.streams() == {"contact"}, 10, "one")
        with viewer(bridge.url) as second:
            second.subscribe("skin", "height", "contact")
            wait_until(lambda: bridge.streams() == {"contact", "height"}, 10, "two")
            second.unsubscribe("height")
            first.unsubscribe("contact")
        wait_until(lambda: not bridge.streams(), 10, "the second is gone")


def test_a_viewer_that_reads_nothing_is_bounded_and_no_other_waits_for_it() -> None:
    server = viewers.Viewers("127.0.0.1", 0, lambda: None)
    schema = {"title": "t.T", "type": "object"}
    pictures, others = server.advertise({"pictures": schema, "others": schema})
    url = f"ws://127.0.0.1:{server.port}"
    with viewer(url, max_queue=1) as slow, viewer(url) as other:
        slow.subscribe("pictures")
        other.subscribe("others")
        wait_until(lambda: server.watched(pictures) and server.watched(others), 10, "both watch")
        for _ in range(200):
            server.send(pictures, bytes(1 << 20))
        server.send(others, b"{}")
        assert other.until("others") == [{}]
        one = next(each for each in server.viewers() if each.subscriptions == {pictures: pictures})
        assert one.missed > 100  # what the kernel's buffers took was sent
        assert sum(map(len, one.waiting)) == one.waiting_bytes <= viewers.WAITING_BYTES_MAX
    wait_until(lambda: server.missed == one.missed, 10, "counted")
    server.stop()


def hostile_infos() -> Iterator[bytes]:
    """Geometries that no sensor has."""
    info = json.loads(INFO)
    for key in (
        "radius_px",
        "skin_radius_mm",
        "visible_half_angle_deg",
        "row_c",
        "camera_distance_mm",
    ):
        for number in NUMBERS:
            changed = {**info, "geometry": {**info["geometry"], key: "?"}}
            yield json.dumps(changed).replace('"?"', number).encode()
    yield json.dumps(
        {**info, "geometry": {**info["geometry"], "flange_T_sensor": [0.0] * 7}}
    ).encode()
    yield from (b"{", b"[]", b"\xff", b"[" * 60_000, b"{}", b"0")


def test_the_real_sensor_is_shown_among_what_no_daemon_publishes(
    caplog: pytest.LogCaptureFixture,
) -> None:
    bridge = Bridge()
    for number, payload in enumerate(hostile_infos()):
        bridge.hear("info", payload, f"bad{number}")
    for number in range(1000):
        bridge.hear("state", b"online", f"invented{number}")
    bridge.hear("info", INFO)
    bridge.hear("state", b"online")
    for number in range(1000):
        bridge.hear("info", INFO, f"later{number}")
    with viewer(bridge.url) as seen:
        seen.subscribe("height")
        wait_until(lambda: bridge.streams() == {"height"}, 10, "watched")
        bridge.hear(
            "height", binary.encode_height(bump(1, 1.0, 236.0, 328.0, 8), calibration_crc32=CRC)
        )
        assert seen.until("height")[0].frame_id == "drawn/sensor"
        assert len(seen.channels) < 400
    bridge.stop()
    assert 1 <= len(caplog.records) < 100


@pytest.mark.broker
def test_it_ends_at_once_with_connections_that_say_nothing(tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        BridgeProcess("foxglove", broker.port, tmp_path / "log") as process,
        contextlib.ExitStack() as idle,
    ):
        for _ in range(100):
            idle.enter_context(socket.create_connection(("127.0.0.1", process.port), 5))
        assert process.threads() < 20
        assert process.stopped_s() < patience(4)


def vertices_mm(scene: Any) -> F64:
    return np.array([(p.x, p.y, p.z) for p in scene.entities[0].triangles[0].points]) * 1000


def least_radius_mm(scene: Any) -> float:
    return float(np.linalg.norm(vertices_mm(scene), axis=1).min())
