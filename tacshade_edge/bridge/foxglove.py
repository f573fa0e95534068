"""Hands in Foxglove and its kin: what a viewer subscribes to, and nothing else, is asked of the broker and encoded."""

from __future__ import annotations

import json
import logging
import re
import threading
import time
from collections.abc import Callable
from typing import Any, Final

import foxglove
from foxglove.channels import (
    CompressedImageChannel,
    FrameTransformsChannel,
    LogChannel,
    PointCloudChannel,
    RawImageChannel,
    SceneUpdateChannel,
)

from tacshade_edge.bridge import foxglove_messages as made
from tacshade_edge.core.geometry.disc import Grid
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.protocol import wire
from tacshade_edge.protocol.received import Info, decode_info
from tacshade_edge.protocol.wire import CloudMessage, HeightMessage
from tacshade_edge.quoting import escaped, quoted

_log = logging.getLogger(__name__)

HANDS_MAX: Final = 32
SKIN_PERIOD_NS: Final = 200_000_000
_BACKLOG: Final = 64
"""Messages that wait for a viewer that does not keep up; the oldest go. A viewer is told of a hand in nine."""

_HAND: Final = re.compile(r"tacshade/([A-Za-z0-9_-]{1,64})/(.+)")
_LOG_CHARS_MAX: Final = 500
# channel: what it is made of. Transforms ride along with whatever else is asked for.
_TOPICS: Final[dict[str, tuple[str, ...]]] = {
    "height": ("height",),
    "cloud": ("cloud",),
    "skin": ("height",),
    "map": ("map/cloud",),
    "preview": ("preview",),
    "contact": ("contact",),
    "health": ("health",),
    "log": ("state", "status/+", "event/slip"),
    "tf": (),
}


class _Hand:
    """One hand's channels."""

    def __init__(self, sensor_id: str, context: foxglove.Context) -> None:
        self._id, self._base = sensor_id, f"tacshade/{sensor_id}"
        root = f"/{self._base}"
        json_of_any = {"title": "tacshade.Health", "type": "object"}
        self._channels: dict[str, Any] = {
            "height": RawImageChannel(f"{root}/height", context=context),
            "cloud": PointCloudChannel(f"{root}/cloud", context=context),
            "skin": SceneUpdateChannel(f"{root}/skin", context=context),
            "map": PointCloudChannel(f"{root}/map", context=context),
            "preview": CompressedImageChannel(f"{root}/preview", context=context),
            "contact": foxglove.Channel(f"{root}/contact", schema=made.CONTACT_SCHEMA, context=context),
            "health": foxglove.Channel(f"{root}/health", schema=json_of_any, context=context),
            "log": LogChannel(f"{root}/log", context=context),
            "tf": FrameTransformsChannel(f"{root}/tf", context=context),
        }
        self._info = Info(geometry=None, profile="")
        self._skin_ns = 0
        self._kept: dict[str, Callable[[], Any]] = {}

    def wanted(self) -> set[str]:
        """Topics that somebody watches something of."""
        return {
            f"{self._base}/{topic}"
            for name, channel in self._channels.items()
            if channel.has_sinks()
            for topic in _TOPICS[name]
        }

    def repeat(self) -> None:
        """What does not come again by itself, for one who came later."""
        for name, message in self._kept.items():
            self._send(name, message)

    def hear(self, topic: str, payload: bytes) -> None:
        """Tell the viewers. Raises DecodeError."""
        now_ns = time.time_ns()
        match topic:
            case "info":
                self._info = info = decode_info(payload)
                self._keep("tf", lambda: made.flange_T_sensor(info, self._id, now_ns))
                self._keep("skin", lambda: made.skin(*made.untouched(info), info, self._id, now_ns))
            case "height":
                self._height(payload)
            case "cloud":
                cloud = self._cloud(payload)
                self._send("cloud", lambda: made.cloud(cloud, self._id))
                self._pose(cloud)
            case "map/cloud":
                cloud = self._cloud(payload)
                self._keep("map", lambda: made.cloud(cloud, self._id, "base"))
            case "preview":
                self._send("preview", lambda: made.picture(payload, self._id, now_ns))
            case "contact" | "health":
                self._send(topic, lambda: payload)
            case "state" | "event/slip":
                self._line(topic, payload.decode(errors="replace"), warns=payload not in (b"online", b"stopped"))
            case _:
                self._status(topic, payload)

    def _height(self, payload: bytes) -> None:
        message = wire.decode(payload)
        if not isinstance(message, HeightMessage):
            raise DecodeError("height: found another kind of payload")
        self._send("height", lambda: made.image(message, self._id))
        self._pose(message)
        if message.contact and 0 <= message.t_ns - self._skin_ns < SKIN_PERIOD_NS:
            return  # the end of a contact is always shown
        self._skin_ns = message.t_ns
        rows, cols = message.height_mm.shape
        grid = Grid(rows, cols, message.row0, message.col0, message.step_px)
        info = self._info
        self._keep("skin", lambda: made.skin(message.height_mm, grid, info, self._id, message.wall_ns))

    def _cloud(self, payload: bytes) -> CloudMessage:
        message = wire.decode(payload)
        if not isinstance(message, CloudMessage):
            raise DecodeError("cloud: found another kind of payload")
        return message

    def _pose(self, message: HeightMessage | CloudMessage) -> None:
        if (pose := message.pose) is not None:
            self._send("tf", lambda: made.base_T_flange(pose, self._id, message.wall_ns))

    def _status(self, topic: str, payload: bytes) -> None:
        try:
            status = json.loads(payload or b"{}")
            reason = str(status.get("reason") or "")
            text = f"{status.get('state')}{': ' if reason else ''}{reason}"
        except (ValueError, AttributeError, RecursionError) as error:
            raise DecodeError(f"{topic}: {error}, expected a JSON object") from error
        self._line(topic, text, warns=bool(reason))

    def _line(self, topic: str, text: str, *, warns: bool) -> None:
        shown = escaped(text, _LOG_CHARS_MAX)
        self._send("log", lambda: made.log(f"{self._base}/{topic}", shown, time.time_ns(), warns=warns))

    def _keep(self, name: str, message: Callable[[], Any]) -> None:
        self._kept[name] = message
        self._send(name, message)

    def _send(self, name: str, message: Callable[[], Any]) -> None:
        """Make and send a message that somebody watches."""
        channel = self._channels[name]
        if channel.has_sinks():
            channel.log(message())


class FoxgloveBridge:
    """Serves hands to viewers.

    Parameters
    ----------
    host, port : str, int
        To listen on; port 0 is any free one.
    sensors : sequence of str
        Hands to show; empty is all that come.
    follow : callable
        Gets all topics that are wanted now.

    Attributes
    ----------
    port : int

    Raises
    ------
    ConfigError
        It cannot listen there.
    """

    def __init__(self, host: str, port: int, sensors: list[str], follow: Callable[[set[str]], None]) -> None:
        self._sensors, self._follow = sensors, follow
        self._context = foxglove.Context()
        self._hands: dict[str, _Hand] = {}
        self._lock = threading.Lock()
        self._changed = threading.Event()
        self._changed.set()
        try:
            self._server = foxglove.start_server(
                name="tacshade-edge",
                host=host,
                port=port,
                server_listener=self,
                context=self._context,
                message_backlog_size=_BACKLOG,
            )
        except RuntimeError as error:
            raise ConfigError(f"--listen {host}:{port}: {error}, expected an address to listen on") from None
        self.port = self._server.port

    def stop(self) -> None:
        """Close the viewers' connections."""
        self._server.stop()

    def hear(self, topic: str, payload: bytes, _retained: bool) -> None:
        """A message of the broker's."""
        if not (found := _HAND.fullmatch(topic)):
            return
        sensor_id, rest = found.groups()
        try:
            with self._lock:
                hand = self._hands.get(sensor_id)
                if hand is None and rest == "info" and payload and self._has_room(sensor_id):
                    hand = self._hands[sensor_id] = _Hand(sensor_id, self._context)
                    _log.info("%s is there", sensor_id)
                if hand is not None and payload:
                    hand.hear(rest, payload)
        except DecodeError as error:
            _log.warning("%s: %s", sensor_id, error)

    def poll(self) -> None:
        """Follow what the viewers watch by now; call ten times a second."""
        if not self._changed.is_set():
            return
        self._changed.clear()
        topics = {f"tacshade/{sensor_id}/info" for sensor_id in self._sensors or ["+"]}
        with self._lock:
            topics = topics.union(*(hand.wanted() for hand in self._hands.values()))
            for hand in self._hands.values():
                hand.repeat()
        self._follow(topics)

    def _has_room(self, sensor_id: str) -> bool:
        if len(self._hands) < HANDS_MAX:
            return True
        _log.warning("%s is one hand more than the %d that are shown", quoted(sensor_id), HANDS_MAX)
        return False

    # -- called by the server, in its threads, with locks of its own held -----------------------------------------

    def on_subscribe(self, _client: object, _channel: object) -> None:
        """A viewer began to watch a channel."""
        self._changed.set()

    def on_unsubscribe(self, _client: object, _channel: object) -> None:
        """A viewer ended that, or went."""
        self._changed.set()
