"""The bridge as ROS 2 meets it: a Zenoh router in the test's own process, and peers that do what
`rmw_zenoh` does (its tokens, its subscribers); rosbags reads the messages.
"""

from __future__ import annotations

import itertools
import json
import logging
import os
import re
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.mqtt_rig import Broker, free_port
from support.patience import patience, wait_until
from support.published_sensor import CRC, PublishedSensor, bump, calibration, health
from tacshade_edge.types import Pose, Touch
from tacshade_edge.wire import binary, messages
from tacshade_edge.wire.stamped_jpeg import stamped

zenoh = pytest.importorskip("zenoh", reason="the extra ros2 is not installed")
ext = pytest.importorskip("zenoh.ext", reason="the extra ros2 is not installed")
ros2 = pytest.importorskip("tacshade_edge.bridge.ros2", reason="the extra ros2 is not installed")

from tacshade_edge.bridge import ros_messages as made  # noqa: E402
from tacshade_edge.bridge.ros_graph import RosTopic, gid_of  # noqa: E402

# A router and each session take a third of a second to open and close.
pytestmark = pytest.mark.slow
INFO = messages.encode_info(
    version="0", config_digest="0", profile="fast", calibration=calibration()
)
PRESS = bump(7, 2.0, 236.0, 328.0, step_px=4)
POSE = Pose(PRESS.t_ns, 100.0, -20.0, 300.0, 0.5, 0.5, 0.5, 0.5)
SERIAL = messages.encode_status("connected", None, {})


def opened(mode: str, port: int) -> Any:
    """A session as the default settings of `rmw_zenoh` make it."""
    where = {"listen" if mode == "router" else "connect": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}
    config = {
        "mode": mode,
        "scouting": {"multicast": {"enabled": False}},
        "timestamping": {"enabled": True},
        **where,
    }
    if mode == "peer":
        config["listen"] = {"endpoints": ["tcp/127.0.0.1:0"]}
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


@contextmanager
def routed(port: int) -> Iterator[None]:
    router = opened("router", port)
    yield
    router.close()


@cache
def store() -> Any:
    typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY)


class Ros:
    """A session of another process in the graph, such as RViz."""

    def __init__(self, port: int, domain: int = 0) -> None:
        self._session, self._domain = opened("peer", port), domain
        self._zid = str(self._session.info.zid())
        self._number, self._kept = 0, list[Subscription]()
        self.close = self._session.close

    def subscribe(self, name: str, kind: made.RosType, *, latched: bool = False) -> Subscription:
        self._number += 1
        topic = RosTopic(name, kind, 5, latched=latched)
        key, handler = topic.key(self._domain), zenoh.handlers.FifoChannel(1000)
        if latched:
            history = ext.HistoryConfig(detect_late_publishers=True)
            subscriber = ext.declare_advanced_subscriber(
                self._session, key, handler, history=history
            )
        else:
            subscriber = self._session.declare_subscriber(key, handler)
        parts = key.split("/")[-2:]
        token = (
            f"@ros2_lv/{self._domain}/{self._zid}/0/{self._number}/MS/%/%/rviz/"
            f"{name.replace('/', '%')}/{parts[0]}/{parts[1]}/{topic.qos()}"
        )
        declared = self._session.liveliness().declare_token(token)
        # What nobody holds is undeclared.
        self._kept.append(Subscription(subscriber, declared, kind))
        return self._kept[-1]

    def tokens(self) -> list[str]:
        replies = self._session.liveliness().get(f"@ros2_lv/{self._domain}/**")
        return sorted(str(reply.ok.key_expr) for reply in replies)


class Subscription:
    def __init__(self, subscriber: Any, token: Any, kind: made.RosType) -> None:
        self._subscriber, self._token, self._kind = subscriber, token, kind
        self.attachments: list[tuple[int, int, int, bytes]] = []

    def take(self, send: Callable[[], None] = lambda: None) -> Any:
        """The next message, decoded: of what `send` sends, again and again, because a busy
        machine's queue may drop one.
        """
        found: list[Any] = []
        polls = itertools.count()

        def received() -> bool:
            if next(polls) % 100 == 0:
                send()
            if (sample := self._subscriber.try_recv()) is not None:
                found.append(sample)
            return bool(found)

        wait_until(received, 10, f"a {self._kind.name}")
        self.attachments.append(struct.unpack("<qqB16s", bytes(found[0].attachment)))
        return store().deserialize_cdr(bytes(found[0].payload), self._kind.name)

    def is_empty(self) -> bool:
        return self._subscriber.try_recv() is None

    def close(self) -> None:
        self._token.undeclare()
        self._subscriber.undeclare()


class Bridge:
    """A bridge that the test feeds with a broker's messages;
    `asked` are the topics that it subscribes to.
    """

    def __init__(self, port: int, domain: int = 0) -> None:
        self.asked: set[str] = set()
        self._bridge = ros2.Ros2Bridge(f"tcp/127.0.0.1:{port}", domain, [], self._follow)
        self.stop, self.poll = self._bridge.stop, self._bridge.poll

    def _follow(self, topics: set[str]) -> None:
        self.asked = topics

    def hear(self, topic: str, payload: bytes, sensor_id: str = "left-index") -> None:
        self._bridge.hear(f"tacshade/{sensor_id}/{topic}", payload, is_retained=False)

    def follows(self, *names: str) -> bool:
        """Whether it asks for these of the sensor, and for no others beside the usual."""
        self.poll()
        return {topic.split("/", 2)[2] for topic in self.asked if "+" not in topic} == {*names}


@pytest.fixture
def port() -> Iterator[int]:
    port = free_port()
    with routed(port):
        yield port


@pytest.fixture
def bridge(port: int) -> Iterator[Bridge]:
    made = Bridge(port)
    wait_until(lambda: made.poll() or made.asked, 10, "connected")
    made.hear("info", INFO)
    made.hear("state", b"online")
    yield made
    made.stop()


@pytest.fixture
def ros(port: int) -> Iterator[Ros]:
    made = Ros(port)
    yield made
    made.close()


def encoded_height(seq: int = 7, **more: Any) -> bytes:
    return binary.encode_height(replace(PRESS, seq=seq), calibration_crc32=CRC, **more)


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def test_ros_lists_the_node_and_its_topics(bridge: Bridge, ros: Ros) -> None:
    wait_until(lambda: len(ros.tokens()) >= 8, 10, "tokens")
    node, *publishers = sorted(ros.tokens(), key=lambda token: int(token.split("/")[4]))
    assert re.fullmatch(r"@ros2_lv/0/[0-9a-f]+/0/0/NN/%/%/tacshade_bridge", node)
    names = {token.split("/")[9] for token in publishers}
    streams = {f"%tacshade%left_index%{name}" for name in ("height", "camera", "cloud", "wrench")}
    assert names == {"%tf", "%tf_static", "%diagnostics", *streams}
    assert {token.split("/")[5] for token in publishers} == {"MP"}


def test_what_nobody_listens_to_is_not_asked_for(bridge: Bridge, ros: Ros) -> None:
    wait_until(bridge.follows, 10, "nothing")
    bridge.hear("height", encoded_height())
    heights = ros.subscribe("/tacshade/left_index/height", made.IMAGE)
    wait_until(lambda: bridge.follows("height"), 10, "asked")
    second = ros.subscribe("/tacshade/left_index/height", made.IMAGE)
    clouds = ros.subscribe("/tacshade/left_index/cloud", made.CLOUD)
    wait_until(lambda: bridge.follows("height", "cloud"), 10, "asked")
    heights.close()
    clouds.close()
    wait_until(lambda: bridge.follows("height"), 10, "one is left")
    assert second.is_empty()
    second.close()
    wait_until(bridge.follows, 10, "nothing")


def test_ros_sees_a_press(bridge: Bridge, ros: Ros) -> None:
    heights = ros.subscribe("/tacshade/left_index/height", made.IMAGE)
    clouds = ros.subscribe("/tacshade/left_index/cloud", made.CLOUD)
    wrenches = ros.subscribe("/tacshade/left_index/wrench", made.WRENCH)
    cameras = ros.subscribe("/tacshade/left_index/camera", made.IMAGE)
    moving = ros.subscribe("/tf", made.TRANSFORMS)
    wait_until(lambda: bridge.follows("height", "cloud", "touch", "preview"), 10, "asked")
    touch = Touch({"force_x_n": 0.5, "force_z_n": -2.0}, {"force_x_n": 0.1, "force_z_n": 0.1})
    _, jpeg = cv2.imencode(".jpg", np.full((24, 32, 3), 80, np.uint8))

    def sender(topic: str, payload: bytes) -> Callable[[], None]:
        return lambda: bridge.hear(topic, payload)

    for seq in (7, 8):
        image = heights.take(sender("height", encoded_height(seq, pose=POSE)))
        assert (stamp_ns(image), image.encoding) == (PRESS.wall_ns, "32FC1")
        assert image.header.frame_id == "left_index_sensor_optical"
    first, second = (sequence for sequence, *_ in heights.attachments)
    assert 1 <= first < second
    token = next(
        token for token in ros.tokens() if "%left_index%height" in token and "/MP/" in token
    )
    assert {gid for *_, gid in heights.attachments} == {gid_of(token)}
    cloud = binary.encode_cloud(PRESS, calibration_crc32=CRC)
    assert clouds.take(sender("cloud", cloud)).width == len(PRESS.cloud.labels)
    forces = messages.encode_touch(replace(PRESS, touch=touch))
    assert wrenches.take(sender("touch", forces)).wrench.force.z == -2.0
    preview = stamped(jpeg.tobytes(), 1_700_000_000_500_000_000)
    picture = cameras.take(sender("preview", preview))
    assert (picture.encoding, picture.width, picture.height) == ("8UC1", 32, 24)
    assert stamp_ns(picture) == 1_700_000_000_500_000_000
    (transform,) = moving.take().transforms
    assert transform.header.frame_id == "left_index_base"
    assert transform.child_frame_id == "left_index_flange"
    assert transform.transform.translation.x == pytest.approx(0.1)


def test_a_late_subscriber_gets_where_the_sensors_are(bridge: Bridge, ros: Ros) -> None:
    bridge.hear("info", INFO, "thumb")
    fixed = ros.subscribe("/tf_static", made.TRANSFORMS, latched=True).take()
    assert [(one.header.frame_id, one.child_frame_id) for one in fixed.transforms] == [
        ("left_index_flange", "left_index_sensor_optical"),
        ("thumb_flange", "thumb_sensor_optical"),
    ]


def test_transforms_alone_need_the_maps_of_sensors_with_robots(bridge: Bridge, ros: Ros) -> None:
    moving = ros.subscribe("/tf", made.TRANSFORMS)
    wait_until(bridge.follows, 10, "nothing")
    bridge.hear("status/serial", SERIAL)
    wait_until(lambda: bridge.follows("height"), 10, "asked")
    posed = encoded_height(pose=POSE)
    transform = moving.take(lambda: bridge.hear("height", posed)).transforms[0]
    assert stamp_ns(transform) == PRESS.wall_ns


def test_the_health_is_diagnosed(bridge: Bridge, ros: Ros) -> None:
    diagnostics = ros.subscribe("/diagnostics", made.DIAGNOSTICS)
    wait_until(lambda: bridge.poll() or "tacshade/+/health" in bridge.asked, 10, "asked")
    (status,) = diagnostics.take(lambda: bridge.hear("health", health())).status
    assert (status.level, status.name) == (1, "tacshade: left-index")
    bridge.hear("state", b"offline")
    (status,) = diagnostics.take().status
    assert (status.level, status.message) == (2, "offline")


@pytest.mark.parametrize(
    ("topic", "payload"),
    [
        ("height", b"TCSH"),
        ("cloud", b""),
        ("touch", b"{"),
        ("preview", b"\xff\xd8x"),
        ("state", b"?"),
    ],
)
def test_what_is_damaged_is_left_out(
    bridge: Bridge, ros: Ros, topic: str, payload: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    kinds = {"height": made.IMAGE, "cloud": made.CLOUD, "wrench": made.WRENCH, "camera": made.IMAGE}
    streams = [ros.subscribe(f"/tacshade/left_index/{name}", kind) for name, kind in kinds.items()]
    wait_until(lambda: bridge.follows("height", "cloud", "touch", "preview"), 10, "asked")
    bridge.hear(topic, payload)
    assert all(stream.is_empty() for stream in streams)
    assert bool(payload) == bool(caplog.records)


def test_two_sensors_of_one_name_in_ros(bridge: Bridge, caplog: pytest.LogCaptureFixture) -> None:
    bridge.hear("info", INFO, "left_index")
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith("left_index: ignoring this sensor: its name in ROS, left_index, is that")


def test_the_router_may_come_late_and_go(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    port = free_port()
    bridge = Bridge(port)
    where = f"tcp/127.0.0.1:{port}"
    fix = "to start one: ros2 run rmw_zenoh_cpp rmw_zenohd"

    def last(text: str) -> bool:
        bridge.poll()
        return bool(caplog.records) and caplog.records[-1].getMessage() == f"{where}: {text}"

    wait_until(lambda: last(f"no Zenoh router answers; {fix}"), 10, "absent")
    for _ in range(2):
        with routed(port):
            wait_until(lambda: last("connected, domain 0"), 20, "connected")
            ros = Ros(port)
            bridge.hear("info", INFO)
            ros.subscribe("/tacshade/left_index/height", made.IMAGE)
            wait_until(lambda: bridge.follows("height"), 20, "asked")
            ros.close()
        wait_until(lambda: last(f"the router is gone; {fix}"), 20, "gone")
        wait_until(bridge.follows, 20, "nobody listens")
    bridge.stop()


def test_ros_in_another_domain_is_reported(
    port: int, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(ros2, "SETTLE_S", 0.0)
    ros = Ros(port, domain=5)
    ros.subscribe("/tf", made.TRANSFORMS)
    bridge = Bridge(port)
    found = f"tcp/127.0.0.1:{port}: found ROS only in domain 5, not in 0; expected one domain; "
    wait_until(lambda: bridge.poll() or found in caplog.text, 10, "reported")
    bridge.stop()
    ros.close()


@pytest.mark.broker
def test_the_command(port: int, ros: Ros, tmp_path: Path) -> None:
    heights = ros.subscribe("/tacshade/drawn/height", made.IMAGE)
    with Broker(tmp_path) as broker, PublishedSensor(broker.port) as sensor:
        words = f"bridge ros2 --router 127.0.0.1:{port} --broker 127.0.0.1:{broker.port}"
        child = subprocess.Popen(
            [sys.executable, "-m", "tacshade_edge", *words.split()],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "ROS_DOMAIN_ID": "0"},
        )
        try:
            assert child.stdout is not None
            assert f"domain 0 through the router tcp/127.0.0.1:{port}" in child.stdout.readline()

            def shown() -> bool:
                sensor.show(PRESS)
                return not heights.is_empty()

            wait_until(shown, 20, "a height")
            assert heights.take().encoding == "32FC1"
        finally:
            child.send_signal(signal.SIGTERM)
            _, error = child.communicate(timeout=patience(20))
    assert (child.returncode, "Traceback" in error) == (0, False)
