"""Shows sensors to ROS 2 through `rmw_zenoh`, as a node of its graph; requests, decodes and encodes
only what has a subscription there.
"""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from tacshade_edge.bridge import ros_messages as made
from tacshade_edge.bridge.ros_graph import RosTopic, ros_name
from tacshade_edge.bridge.ros_health import diagnosis
from tacshade_edge.bridge.ros_session import RosPublisher, RosSession
from tacshade_edge.bridge.roster import Refusals, Roster
from tacshade_edge.errors import DecodeError
from tacshade_edge.wire.binary import CloudMessage, HeightMessage
from tacshade_edge.wire.health_topics import Health
from tacshade_edge.wire.sensor_topics import Info
from tacshade_edge.wire.stamped_jpeg import capture_wall_ns
from tacshade_edge.wire.topics import (
    ALIVE,
    OF_SENSORS,
    State,
    decode_health,
    decode_info,
    decode_preview,
    decode_state,
    decode_touch,
)

_log = logging.getLogger(__name__)

SENSORS_MAX: Final = 32
_RETRY_S: Final = 1.0
SETTLE_S: Final = 3.0
"""How long the tokens of a network may take to arrive, one after the other."""
_TOPIC: Final = re.compile(r"tacshade/([A-Za-z0-9_-]{1,64})/(.+)")
_EVERY: Final = ("info", "state", "status/serial")
# topic below the sensor's: its type, and the sensor's topic that it is made from.
_STREAMS: Final = {
    "height": (made.IMAGE, "height"),
    "camera": (made.IMAGE, "preview"),
    "cloud": (made.CLOUD, "cloud"),
    "wrench": (made.WRENCH, "touch"),
}
_DEPTH: Final = 5
_ROUTER_FIX: Final = "to start one: ros2 run rmw_zenoh_cpp rmw_zenohd"
_DOMAIN_FIX: Final = "expected one domain; to change it: --domain, or export ROS_DOMAIN_ID"
# Depths as tf2 and the diagnostics' own publishers have them.
_TF: Final = RosTopic("/tf", made.TRANSFORMS, 100)
_TF_STATIC: Final = RosTopic("/tf_static", made.TRANSFORMS, 1, latched=True)
_DIAGNOSTICS: Final = RosTopic("/diagnostics", made.DIAGNOSTICS, 10)


class _Sensor:
    """One sensor: the topics that it has once it has published its `info`."""

    def __init__(self, sensor_id: str, session: RosSession, moving: RosPublisher) -> None:
        self._base, self.name = f"tacshade/{sensor_id}", ros_name(sensor_id)
        self._session, self._moving = session, moving
        self._streams: dict[str, RosPublisher] = {}
        self._info: Info | None = None
        self._has_robot = False
        self.state: State | Literal[""] = ""
        self.fixed: made.Transform | None = None
        """Where the sensor is on the flange."""

    @property
    def rank(self) -> int:
        """0 without an `info`; higher if the sensor is calibrated or alive, as an invented one
        hardly is.
        """
        return (
            0
            if self._info is None
            else 1 + (self._info.geometry is not None) + (self.state in ALIVE)
        )

    def close(self) -> None:
        for publisher in self._streams.values():
            publisher.close()

    def wanted(self) -> set[str]:
        """Return the MQTT topics that ROS's subscriptions need."""
        names = {
            _STREAMS[name][1]
            for name, publisher in self._streams.items()
            if self._session.count(publisher)
        }
        # A pose comes with each map.
        if self._has_robot and self._session.count(self._moving):
            names.add("height")
        return {f"{self._base}/{name}" for name in names}

    def place(self, info: Info) -> None:
        """Take over the sensor's place on the robot."""
        if not self._streams:
            self._streams = {
                name: self._session.advertise(
                    RosTopic(f"/tacshade/{self.name}/{name}", kind, _DEPTH)
                )
                for name, (kind, _) in _STREAMS.items()
            }
            _log.info("showing %s as /tacshade/%s", self._base, self.name)
        self._info = info
        if info.geometry is not None:
            seven = info.geometry.flange_T_sensor
            self.fixed = self._transform(seven, time.time_ns(), "flange", "sensor_optical")

    def hear(self, topic: str, payload: bytes) -> None:
        """Send a message from the sensor to ROS. Raises DecodeError."""
        match topic:
            case "state":
                self.state = decode_state(payload)
            case "status/serial":
                self._has_robot = True
            case "height":
                self._height(payload)
            case "cloud" if self._has_listener("cloud"):
                cloud: CloudMessage = OF_SENSORS[topic].decode(topic, payload)
                self._send("cloud", made.cloud(cloud, self._frame))
                self._pose(cloud)
            case "touch" if self._has_listener("wrench"):
                self._send("wrench", made.wrench(decode_touch(payload), self._frame))
            case "preview" if self._has_listener("camera"):
                self._send("camera", _picture(decode_preview(topic, payload), self._frame))

    def _height(self, payload: bytes) -> None:
        is_asked = self._has_listener("height")
        if not is_asked and not self._session.count(self._moving):
            return
        message: HeightMessage = OF_SENSORS["height"].decode("height", payload)
        if is_asked:
            self._send("height", made.height(message, self._frame))
        self._pose(message)

    def _pose(self, message: HeightMessage | CloudMessage) -> None:
        if (pose := message.pose) is not None and self._session.count(self._moving):
            seven = (pose.x_mm, pose.y_mm, pose.z_mm, pose.qw, pose.qx, pose.qy, pose.qz)
            placed = self._transform(seven, message.wall_ns, "base", "flange")
            self._moving.put(made.transforms([placed]))

    @property
    def _frame(self) -> str:
        return made.frame_name(self.name, "sensor_optical")

    def _transform(
        self, seven: Sequence[float], wall_ns: int, parent: made.Frame, child: made.Frame
    ) -> made.Transform:
        names = made.frame_name(self.name, parent), made.frame_name(self.name, child)
        return made.Transform(seven, wall_ns, *names)

    def _has_listener(self, name: str) -> bool:
        publisher = self._streams.get(name)
        return publisher is not None and self._session.count(publisher) > 0

    def _send(self, name: str, payload: bytearray | None) -> None:
        if payload is not None:
            self._streams[name].put(payload)


def _picture(jpeg: bytes, frame_id: str) -> bytearray:
    # OpenCV takes more memory than all else here, and few show the camera.
    import cv2

    from tacshade_edge.files.image_bytes import decode_image

    grey = decode_image(jpeg, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    wall_ns = capture_wall_ns(jpeg)
    return made.camera(grey, time.time_ns() if wall_ns is None else wall_ns, frame_id)


@dataclass(frozen=True, slots=True)
class _Graph:
    """The bridge's node in ROS's graph, with the publishers of all sensors together."""

    session: RosSession
    moving: RosPublisher
    fixed: RosPublisher
    health: RosPublisher


class Ros2Bridge:
    """Serves sensors to ROS 2, all if `sensors` is empty; `follow` gets the topics needed.

    Until a router answers, `poll` asks once a second, and no topic is followed.
    """

    def __init__(
        self, endpoint: str, domain: int, sensors: list[str], follow: Callable[[set[str]], None]
    ) -> None:
        self._endpoint, self._domain = endpoint, domain
        self._sensors, self._follow = sensors, follow
        self._graph: _Graph | None = None
        self._roster: Roster[_Sensor] = Roster(
            SENSORS_MAX, self._sensor, lambda sensor: sensor.rank, _Sensor.close
        )
        self._refusals = Refusals()
        # paho's thread hears, the main thread polls.
        self._lock = threading.Lock()
        self._followed: set[str] = set()
        self._next_s = self._connected_s = 0.0
        self._reported: str | None = None

    def stop(self) -> None:
        if self._graph is not None:
            self._graph.session.close()

    def hear(self, topic: str, payload: bytes, *, is_retained: bool) -> None:
        with self._lock:
            if self._graph is None or not payload:
                return
            if not (found := _TOPIC.fullmatch(topic)):
                self._refusals.add(
                    "unknown_topic", topic, "ignoring this topic, which is no sensor's"
                )
                return
            (sensor_id, rest), now_ns = found.groups(), time.time_ns()
            try:
                if rest == "info":
                    self._place(self._graph, sensor_id, decode_info(payload))
                elif sensor := self._of(sensor_id, 0):
                    sensor.hear(rest, payload)
                    if rest == "state":
                        self._diagnose(self._graph, sensor_id, sensor, None, now_ns)
                    # A retained `health` may be old.
                    elif rest == "health" and not is_retained:
                        health = decode_health(payload)
                        self._diagnose(
                            self._graph, sensor_id, sensor, health, health.wall_ns or now_ns
                        )
            except DecodeError as error:
                self._refusals.add("undecodable", sensor_id, str(error))

    def poll(self) -> None:
        """Connect if need be, and subscribe to what ROS now listens to; call this ten times a
        second.
        """
        if (graph := self._graph) is None and (graph := self._connect()) is None:
            return
        with self._lock:
            self._graph = graph
            graph.session.poll()
            topics = self._wanted(graph)
            elsewhere = graph.session.elsewhere()
        self._report_graph(graph, elsewhere)
        if topics != self._followed:
            self._followed = topics
            self._follow(topics)

    def _sensor(self, sensor_id: str) -> _Sensor:
        assert self._graph is not None
        return _Sensor(sensor_id, self._graph.session, self._graph.moving)

    def _of(self, sensor_id: str, rank: int) -> _Sensor | None:
        """Return a sensor, None if there is no room for it or its name."""
        if (known := self._roster.get(sensor_id)) is not None:
            return known
        name = ros_name(sensor_id)
        if other := next((key for key, sensor in self._roster if sensor.name == name), None):
            text = f"ignoring this sensor: its name in ROS, {name}, is that of {other} too"
        elif (sensor := self._roster.of(sensor_id, rank)) is not None:
            return sensor
        else:
            text = f"ignoring this sensor: {SENSORS_MAX} are shown, the limit"
        self._refusals.add("no_room", sensor_id, text)
        return None

    def _place(self, graph: _Graph, sensor_id: str, info: Info) -> None:
        if (sensor := self._of(sensor_id, 1 + (info.geometry is not None))) is None:
            return
        sensor.place(info)
        # All in one message, since a late subscriber gets the latest alone.
        fixed = [one.fixed for _, one in self._roster if one.fixed is not None]
        graph.fixed.put(made.transforms(fixed))

    def _diagnose(
        self, graph: _Graph, sensor_id: str, sensor: _Sensor, health: Health | None, wall_ns: int
    ) -> None:
        if graph.session.count(graph.health):
            found = diagnosis(sensor_id, sensor.state, health)
            graph.health.put(made.diagnostics(wall_ns, [found]))

    def _wanted(self, graph: _Graph) -> set[str]:
        every = (*_EVERY, "health") if graph.session.count(graph.health) else _EVERY
        topics = {f"tacshade/{one}/{name}" for one in self._sensors or ["+"] for name in every}
        return topics.union(*(sensor.wanted() for _, sensor in self._roster))

    def _connect(self) -> _Graph | None:
        if time.monotonic() < self._next_s:
            return None
        self._next_s = time.monotonic() + _RETRY_S
        try:
            session = RosSession(self._endpoint, self._domain)
        except ConnectionError as error:
            self._report(f"{error}; {_ROUTER_FIX}")
            return None
        self._connected_s = time.monotonic()
        shared = [session.advertise(topic) for topic in (_TF, _TF_STATIC, _DIAGNOSTICS)]
        return _Graph(session, *shared)

    def _report_graph(self, graph: _Graph, elsewhere: list[str]) -> None:
        if not graph.session.connected:
            self._connected_s = time.monotonic()
            self._report(f"{self._endpoint}: the router is gone; {_ROUTER_FIX}")
        elif not elsewhere:
            self._report("")
        elif time.monotonic() - self._connected_s > SETTLE_S:
            found = f"found ROS only in domain {', '.join(elsewhere)}, not in {self._domain}"
            self._report(f"{self._endpoint}: {found}; {_DOMAIN_FIX}")

    def _report(self, trouble: str) -> None:
        """Log a change, not a repetition; empty is that all is well."""
        if trouble == self._reported:
            return
        self._reported = trouble
        if trouble:
            _log.warning("%s", trouble)
        else:
            _log.info("%s: connected, domain %d", self._endpoint, self._domain)
