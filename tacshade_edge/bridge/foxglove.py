"""Shows sensors in Foxglove and compatible viewers;
requests and encodes only the topics that viewers subscribe to.
"""

from __future__ import annotations

import logging
import math
import re
import threading
import time
from collections.abc import Callable
from typing import Any, Final, Literal

from foxglove.messages import (
    CompressedImage,
    FrameTransforms,
    Log,
    PointCloud,
    RawImage,
    SceneUpdate,
)

from tacshade_edge.bridge import foxglove_messages as made
from tacshade_edge.bridge.roster import Refusals, Roster
from tacshade_edge.bridge.viewers import MESSAGE_BYTES_MAX, Schema, Viewers
from tacshade_edge.errors import DecodeError
from tacshade_edge.quoting import escaped
from tacshade_edge.sensor.geometry.disc import Grid
from tacshade_edge.wire.binary import CloudMessage, HeightMessage
from tacshade_edge.wire.codec import encode_json
from tacshade_edge.wire.messages import TOUCH_SCHEMA
from tacshade_edge.wire.sensor_topics import Info
from tacshade_edge.wire.topics import (
    ALIVE,
    OF_SENSORS,
    State,
    decode_info,
    decode_preview,
    decode_state,
    decode_status,
)

_log = logging.getLogger(__name__)

# A viewer lists every sensor's channels, ten each, whether or not it shows them.
SENSORS_MAX: Final = 32
# Encoding a mesh makes a Python object of each vertex; five a second look fluent.
SKIN_PERIOD_NS: Final = 200_000_000
_TOPIC: Final = re.compile(r"tacshade/([A-Za-z0-9_-]{1,64})/(.+)")
# Reasons and slips are far shorter; what a stranger publishes as one may not be.
_LOG_CHARS_MAX: Final = 500
_SLIP_BYTES_MAX: Final = 4096
# channel: its schema, and the sensor's topics that it is made from.
# Transforms come along with the others' messages.
CHANNELS: Final[dict[str, tuple[Schema, tuple[str, ...]]]] = {
    "height": (RawImage.get_schema(), ("height",)),
    "cloud": (PointCloud.get_schema(), ("cloud",)),
    "skin": (SceneUpdate.get_schema(), ("height",)),
    "map": (PointCloud.get_schema(), ("map/cloud",)),
    "preview": (CompressedImage.get_schema(), ("preview",)),
    "contact": (made.CONTACT_SCHEMA, ("contact",)),
    "touch": (TOUCH_SCHEMA, ("touch",)),
    "health": ({"title": "tacshade.Health", "type": "object"}, ("health",)),
    "log": (Log.get_schema(), ("state", "status/+", "event/slip")),
    "tf": (FrameTransforms.get_schema(), ()),
}
_OWN: Final[dict[str, Schema]] = {
    "/tacshade/bridge": {"title": "tacshade.Bridge", "type": "object"}
}


class _Sensor:
    """One sensor: the channels that it has once it has published its `info`."""

    def __init__(self, sensor_id: str, viewers: Viewers) -> None:
        self._id, self._base = sensor_id, f"tacshade/{sensor_id}"
        self._viewers = viewers
        self._channels: dict[str, int] = {}
        self.state: State | Literal[""] = ""
        self._info: Info | None = None
        self._skin_ns = 0
        # As functions: what nobody watches is never encoded.
        self._kept: dict[str, Callable[[], Any]] = {}

    @property
    def rank(self) -> int:
        """0 without an `info`; higher if the sensor is calibrated or alive,
        as an invented one hardly is.
        """
        return (
            0
            if self._info is None
            else 1 + (self._info.geometry is not None) + (self.state in ALIVE)
        )

    def close(self) -> None:
        self._viewers.withdraw(list(self._channels.values()))

    def wanted(self) -> set[str]:
        """Return the MQTT topics that the watched channels need."""
        return {
            f"{self._base}/{topic}"
            for name, channel in self._channels.items()
            if self._viewers.watched(channel)
            for topic in CHANNELS[name][1]
        }

    def repeat(self) -> None:
        """Send the kept messages again, for viewers that subscribed later:
        the sensor does not repeat them.
        """
        for name, message in self._kept.items():
            self._send(name, message)

    def place(self, info: Info) -> None:
        """Take over the sensor's geometry and its place on the robot."""
        if not self._channels:
            schemas = {f"/{self._base}/{name}": schema for name, (schema, _) in CHANNELS.items()}
            self._channels = dict(zip(CHANNELS, self._viewers.advertise(schemas), strict=True))
            _log.info("showing %s", self._id)
        self._info, now_ns = info, time.time_ns()
        self._keep("tf", lambda: made.flange_T_sensor(info, self._id, now_ns))

    def hear(self, topic: str, payload: bytes) -> None:
        """Send a message from the sensor to the viewers. Raises DecodeError."""
        now_ns = time.time_ns()
        match topic:
            case "height":
                self._height(payload)
            case "cloud":
                cloud: CloudMessage = OF_SENSORS[topic].decode(topic, payload)
                self._send("cloud", lambda: made.cloud(cloud, self._id))
                self._pose(cloud)
            case "map/cloud":
                cloud = OF_SENSORS[topic].decode(topic, payload)
                self._keep("map", lambda: made.cloud(cloud, self._id, "base"))
            case "preview":
                jpeg = decode_preview(topic, payload)
                self._send("preview", lambda: made.picture(jpeg, self._id, now_ns))
            case "contact" | "touch" | "health":
                # Decoded only to refuse what is malformed: viewers get the sensor's own bytes.
                OF_SENSORS[topic].decode(topic, payload)
                self._send(topic, lambda: payload)
            case "state":
                state = self.state = decode_state(payload)
                self._line(topic, state, warns=state in ("degraded", "offline"))
            case "event/slip":
                self._line(topic, payload[:_SLIP_BYTES_MAX].decode(errors="replace"), warns=True)
            case _:
                status = decode_status(topic, payload)
                text = f"{status.state}{': ' if status.reason else ''}{status.reason or ''}"
                self._line(topic, text, warns=bool(status.reason))

    def _height(self, payload: bytes) -> None:
        message: HeightMessage = OF_SENSORS["height"].decode("height", payload)
        if (info := self._info) is None:
            return
        most_mm = math.inf if info.geometry is None else info.geometry.geometry.height_max_mm
        if (message.height_mm > most_mm).any():
            raise DecodeError(
                f"height: found more than a skin has, expected at most {most_mm:g} mm"
            )
        self._send("height", lambda: made.image(message, self._id))
        self._pose(message)
        # Maps in contact are thinned out; the end of a contact is always shown. After a restart of
        # the sensor's board, its clock may be behind.
        if message.contact and 0 <= message.t_ns - self._skin_ns < SKIN_PERIOD_NS:
            return
        self._skin_ns = message.t_ns
        rows, cols = message.height_mm.shape
        grid = Grid(rows, cols, message.row0, message.col0, message.step_px)
        self._keep(
            "skin", lambda: made.skin(message.height_mm, grid, info, self._id, message.wall_ns)
        )

    def _pose(self, message: HeightMessage | CloudMessage) -> None:
        if (pose := message.pose) is not None:
            self._send("tf", lambda: made.base_T_flange(pose, self._id, message.wall_ns))

    def _line(self, topic: str, text: str, *, warns: bool) -> None:
        shown = escaped(text, _LOG_CHARS_MAX)
        self._send(
            "log", lambda: made.log(f"{self._base}/{topic}", shown, time.time_ns(), warns=warns)
        )

    def _keep(self, name: str, message: Callable[[], Any]) -> None:
        self._kept[name] = message
        self._send(name, message)

    def _send(self, name: str, message: Callable[[], Any]) -> None:
        """Make and send a message if a viewer watches its channel. Raises DecodeError."""
        channel = self._channels.get(name)
        if channel is None or not self._viewers.watched(channel):
            return
        one = message()
        payload: bytes = one if isinstance(one, bytes) else one.encode()
        if len(payload) > MESSAGE_BYTES_MAX:
            raise DecodeError(
                f"{name}: found {len(payload)} bytes for a viewer, expected at most "
                f"{MESSAGE_BYTES_MAX}"
            )
        self._viewers.send(channel, payload)


class FoxgloveBridge:
    """Serves sensors to viewers, all if `sensors` is empty; `follow` gets the topics needed.

    Raises OSError.
    """

    def __init__(
        self, host: str, port: int, sensors: list[str], follow: Callable[[set[str]], None]
    ) -> None:
        self._sensors, self._follow = sensors, follow
        self._roster: Roster[_Sensor] = Roster(
            SENSORS_MAX,
            lambda name: _Sensor(name, self._viewers),
            lambda sensor: sensor.rank,
            _Sensor.close,
        )
        self._refusals = Refusals()
        # paho's thread hears, the main thread polls.
        self._lock = threading.Lock()
        self._changed = threading.Event()
        # The first poll subscribes to what every sensor is known by.
        self._changed.set()
        self._viewers = Viewers(host, port, self._changed.set)
        self.port = self._viewers.port
        self._counts = b""
        (self._own,) = self._viewers.advertise(_OWN)

    def stop(self) -> None:
        self._viewers.stop()

    def hear(self, topic: str, payload: bytes, _retained: bool) -> None:
        if not payload:
            return
        with self._lock:
            if not (found := _TOPIC.fullmatch(topic)):
                self._refusals.add(
                    "unknown_topic", topic, "ignoring this topic, which is no sensor's"
                )
                return
            sensor_id, rest = found.groups()
            try:
                # These two alone make room for a sensor: they come without a viewer's asking.
                if rest == "info":
                    info = decode_info(payload)
                    if (
                        placed := self._roster.of(sensor_id, 1 + (info.geometry is not None))
                    ) is not None:
                        placed.place(info)
                        self._changed.set()
                    else:
                        text = f"ignoring this sensor: {SENSORS_MAX} are shown, the limit"
                        self._refusals.add("no_room", sensor_id, text)
                elif (
                    sensor := self._roster.of(sensor_id, 0)
                    if rest == "state"
                    else self._roster.get(sensor_id)
                ):
                    sensor.hear(rest, payload)
            except DecodeError as error:
                self._refusals.add("undecodable", sensor_id, str(error))

    def poll(self) -> None:
        """Subscribe to what the viewers now watch, and send them the counts;
        call this ten times a second.
        """
        with self._lock:
            counts = encode_json({**self._refusals.counts, "passed_over": self._viewers.missed})
        if self._changed.is_set() or counts != self._counts:
            self._counts = counts
            self._viewers.send(self._own, counts)
        if not self._changed.is_set():
            return
        # Before the viewers are asked: what changes meanwhile sets it again.
        self._changed.clear()
        topics = {
            f"tacshade/{sensor_id}/{name}"
            for sensor_id in self._sensors or ["+"]
            for name in ("info", "state")
        }
        with self._lock:
            for _, sensor in self._roster:
                topics |= sensor.wanted()
                sensor.repeat()
        self._follow(topics)
