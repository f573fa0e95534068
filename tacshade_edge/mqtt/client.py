"""One session with a broker, by paho: whom it connects to and how, what it subscribes to, and
what comes back; no policy about what it sends.

The client's wheel contains this file too (client/hatch_build.py).
"""

from __future__ import annotations

import logging
import select
import socket
import ssl
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, TypedDict

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from ..errors import ConfigError, DecodeError

_log = logging.getLogger(__name__)

FRAMES_BYTES_MAX: Final = 1 << 26
"""Bytes, more than any camera's `height` or `cloud`."""
# A request's body has at most 4096 bytes; the rest is room for its topic and properties.
_REQUESTS_BYTES_MAX: Final = 65536
_REASON_CODES: Final = 256  # of one byte
# A broker publishes our last will after one and a half of these without a packet from us.
_KEEPALIVE_S: Final = 10
_RECONNECT_DELAY_S: Final = 1
# paho would wait 5 s for a machine that is switched off, and `stop` for paho.
_CONNECT_TIMEOUT_S: Final = 3.0
# Linux; elsewhere the last two may not exist. Unsent bytes in the kernel are stale frames, so only
# a few are allowed. We give up a peer that accepts nothing for 4 s, before TCP retries less often
# than we reconnect.
_SOCKET_OPTIONS: Final = (
    ("TCP_NODELAY", 1),
    ("TCP_NOTSENT_LOWAT", 1 << 17),
    ("TCP_USER_TIMEOUT", 4000),
)


class BrokerAddress(TypedDict):
    """The address of a broker and the credentials for it:
    arguments of everything that connects to one.
    """

    host: str
    port: int
    username: str | None
    password: str | None
    tls_ca: str | None


def broker_at(
    host: str,
    port: int,
    *,
    username: str | None = None,
    password: str | None = None,
    tls_ca: str | None = None,
) -> BrokerAddress:
    """Return the address of a broker, by default without a user or TLS."""
    return BrokerAddress(host=host, port=port, username=username, password=password, tls_ca=tls_ca)


def _nothing(*_: object) -> None:
    pass


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionEvents:
    """What a session calls, in the thread that reads: paho's after `start`, otherwise that of
    `step`.

    `before_connect`: before each attempt; OSError from it is a failed attempt. `accepted`: the
    broker accepts us, and packets of at most so many bytes (None is any); the subscriptions are
    sent. `subscribed`: the answer to each of a call's topics. `rejected`: a connection, as text
    and as the broker's code. `unreachable`: an attempt failed; its error, and that as text. `lost`:
    a connection that was accepted ended; `unanswered`: one that was not. `heard`: a message, with
    U+FFFD in its topic for what is not UTF-8; DecodeError from it drops and counts the message.
    `answered`: the id and reason code of a message that was sent (QoS 0) or acknowledged (QoS 1).
    `crashed`: what ended the network thread; without it, the thread dies of it.
    """

    before_connect: Callable[[], None] = _nothing
    accepted: Callable[[int | None], None] = _nothing
    subscribed: Callable[[list[ReasonCode]], None] = _nothing
    rejected: Callable[[str, ReasonCode], None] = _nothing
    unreachable: Callable[[BaseException | None, str], None] = _nothing
    lost: Callable[[ReasonCode], None] = _nothing
    unanswered: Callable[[ReasonCode], None] = _nothing
    heard: Callable[[str, MQTTMessage], None] = _nothing
    answered: Callable[[int, ReasonCode], None] = _nothing
    crashed: Callable[[Exception], None] | None = None


class BrokerSession(Client):
    """paho's client, which reconnects by itself every second and which no broker's message can end.

    It uses MQTT 5, since only a version 5 connection receives a request's response topic and
    correlation data; subscribers of version 3.1.1 still receive what it publishes. The broker never
    sends it a packet above `incoming_bytes_max`: requests are small, and memory is bounded.

    `refused`: number of messages that `SessionEvents.heard` could not decode. Raises ConfigError (a
    host name, topic or authority file that can never work).
    """

    # Names with two underscores, since a subclass shares its attributes with paho's.

    def __init__(
        self,
        broker: BrokerAddress,
        events: SessionEvents,
        *,
        client_id: str,
        base_topic: str = "tacshade",
        incoming_bytes_max: int = _REQUESTS_BYTES_MAX,
    ) -> None:
        # First of all: paho's `__del__` fails on what it has not initialised.
        super().__init__(
            CallbackAPIVersion.VERSION2, client_id=client_id, protocol=MQTTProtocolVersion.MQTTv5
        )
        _check(broker["host"], base_topic)
        _accept_any_answer()
        self.refused = 0
        self.__broker, self.__events = broker, events
        self.__incoming_bytes_max = incoming_bytes_max
        self.__lock = threading.Lock()
        self.__topics: dict[str, SubscribeOptions] = {}
        self.__accepted = False
        # Equal bounds turn paho's exponential delay off.
        self.reconnect_delay_set(_RECONNECT_DELAY_S, _RECONNECT_DELAY_S)
        self.connect_timeout = _CONNECT_TIMEOUT_S
        self.on_socket_open = _on_socket_open
        self.on_pre_connect = self.__on_pre_connect
        self.on_connect, self.on_connect_fail = self.__on_connect, self.__on_connect_fail
        self.on_disconnect, self.on_subscribe = self.__on_disconnect, self.__on_subscribe
        self.on_message, self.on_publish = self.__on_message, self.__on_publish
        if broker["username"] is not None:
            self.username_pw_set(broker["username"], broker["password"])
        if (tls_ca := broker["tls_ca"]) is not None:
            try:
                self.tls_set(ca_certs=tls_ca)
            except (OSError, ssl.SSLError) as error:
                raise ConfigError(
                    f"CA certificate file {tls_ca}: {error.strerror or error}; expected a PEM file "
                    "with certificates"
                ) from error

    def start(self) -> None:
        """Start the network thread, which connects and reconnects until `stop`."""
        # A clean start: no broker may keep requests or frames for us while we are away.
        host, port = self.__broker["host"], self.__broker["port"]
        self.connect_async(host, port, _KEEPALIVE_S, clean_start=True, properties=self.__limits())
        self.loop_start()

    def open(self) -> None:
        """Connect without a thread: the caller reads and writes with `step`. Raises OSError."""
        host, port = self.__broker["host"], self.__broker["port"]
        self.connect(host, port, _KEEPALIVE_S, clean_start=True, properties=self.__limits())

    def step(self, timeout_s: float) -> bool:
        """Send and receive once; False without a connection."""
        # Not `Client.loop`: that makes a pair of sockets, which nothing closes.
        if (sock := self.socket()) is None:
            return False
        # Only a write that paho has asked for: a socket is nearly always writable, and we would
        # spin.
        select.select([sock], [sock] if self.want_write() else [], [], timeout_s)
        # `loop_misc` sends the pings; without it the broker ends the connection.
        for once in (self.loop_read, self.loop_write, self.loop_misc):
            if once() != MQTTErrorCode.MQTT_ERR_SUCCESS:
                return False
        return self.socket() is not None

    def stop(self) -> None:
        """Disconnect, and end the network thread."""
        with self.__lock:
            self.__accepted = False  # so that nobody hears of a loss
        self.disconnect()
        self.loop_stop()
        self.release()

    def release(self) -> None:
        """Close what woke the network thread, which has ended."""
        # Otherwise the garbage collector closes these two, perhaps before paho can.
        self._reset_sockets(sockpair_only=True)

    def follow(self, topics: Mapping[str, SubscribeOptions]) -> None:
        """Subscribe to these topics and no others from now on, and on each later connection;
        callable from any thread.
        """
        with self.__lock:
            # Under the lock, because paho's thread subscribes to all topics when it connects.
            new = {topic: how for topic, how in topics.items() if topic not in self.__topics}
            old = self.__topics.keys() - topics.keys()
            self.__topics = dict(topics)
            if self.__accepted:  # else the next connection subscribes to all of them
                self.__subscribe(new)
                if old:
                    self.unsubscribe(sorted(old))

    def __subscribe(self, topics: Mapping[str, SubscribeOptions]) -> None:
        if topics:  # paho refuses an empty list
            self.subscribe(list(topics.items()))

    def __limits(self) -> Properties:
        limits = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        limits.MaximumPacketSize = self.__incoming_bytes_max
        return limits

    def loop_forever(self, *args: Any, **options: Any) -> MQTTErrorCode:
        """Run paho's loop, as its thread does."""
        if (crashed := self.__events.crashed) is None:
            return super().loop_forever(*args, **options)
        try:
            return super().loop_forever(*args, **options)
        except Exception as error:  # noqa: BLE001 - whoever asked for it raises it elsewhere
            crashed(error)
            return MQTTErrorCode.MQTT_ERR_UNKNOWN

    # -- called by paho ----------------------------------------------------------------------------

    def __on_pre_connect(self, _client: Client, _userdata: Any) -> None:
        with self.__lock:
            self.__accepted = False  # paho may lose a connection without a word
        # Outside of the lock: it may take as long as another daemon uses our name.
        self.__events.before_connect()

    def __on_connect(
        self,
        _client: Client,
        _userdata: Any,
        _flags: Any,
        code: ReasonCode,
        properties: Properties | None,
    ) -> None:
        if code.is_failure:
            self.__events.rejected(f"rejects the connection: {code}", code)
            return
        with self.__lock:
            self.__accepted = True
            self.__subscribe(self.__topics)
        # After the subscription: who sees that we are online may send a request at once.
        self.__events.accepted(getattr(properties, "MaximumPacketSize", None))

    def __on_connect_fail(self, _client: Client, _userdata: Any) -> None:
        # paho calls this while it handles the error, and does not pass it on.
        error = sys.exception()
        text = str(getattr(error, "strerror", None) or error or "no connection")
        self.__events.unreachable(error, text)

    def __on_disconnect(
        self, _client: Client, _userdata: Any, _flags: Any, code: ReasonCode, _properties: Any
    ) -> None:
        with self.__lock:
            was, self.__accepted = self.__accepted, False
        (self.__events.lost if was else self.__events.unanswered)(code)

    def __on_subscribe(
        self, _client: Client, _userdata: Any, _mid: int, codes: list[ReasonCode], _p: Any
    ) -> None:
        self.__events.subscribed(codes)

    def __on_publish(
        self, _client: Client, _userdata: Any, mid: int, code: ReasonCode, _properties: Any
    ) -> None:
        self.__events.answered(mid, code)

    def __on_message(self, _client: Client, _userdata: Any, message: MQTTMessage) -> None:
        try:
            self.__events.heard(_topic_of(message), message)
        except DecodeError as error:
            if not self.refused:
                _log.warning(
                    "%s: %s; dropped the message; further ones are only counted", self.host, error
                )
            self.refused += 1


def denial(codes: list[ReasonCode]) -> str:
    """Return what the answer to a subscription denies, for a person; empty if nothing."""
    denied = next((code for code in codes if code.is_failure), None)
    return "" if denied is None else f"rejects a subscription: {denied}"


def _topic_of(message: MQTTMessage) -> str:
    try:
        return message.topic
    except UnicodeDecodeError as error:  # the only public way to the bytes
        return error.object.decode(errors="replace")


def _accept_any_answer() -> None:
    """Make paho accept every reason code in a PUBACK."""
    # paho ends the connection for a code that its table does not list for the packet. mosquitto
    # answers a message above its limit with 0x95, which MQTT 5 lists for CONNACK and DISCONNECT
    # only: every large message would cost a connection. The table is public, and of the process;
    # other clients in it accept more codes then, and no fewer.
    names = dict(ReasonCode.names)
    for value in range(_REASON_CODES):
        known = names.get(value, {})
        if not any(PacketTypes.PUBACK in packets for packets in known.values()):
            name = next(iter(known), f"reason code {value}")
            names[value] = {**known, name: [*known.get(name, ()), PacketTypes.PUBACK]}
    ReasonCode.names = MappingProxyType(names)


def _on_socket_open(_client: Client, _userdata: Any, sock: Any) -> None:
    for name, value in _SOCKET_OPTIONS:
        if hasattr(socket, name):
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _check(host: str, base_topic: str) -> None:
    # `getaddrinfo` raises UnicodeError for such a name, and paho's thread would die of it.
    try:
        sound = bool(host) and bool(host.encode("idna"))
    except UnicodeError:
        sound = False
    if not sound:
        raise ConfigError(f"MQTT host: found {host!r}, expected a host name or an address")
    if not base_topic or base_topic.strip("/") != base_topic or set(base_topic) & set("+#\0"):
        raise ConfigError(
            f"MQTT topic: found {base_topic!r}, expected levels such as tacshade/left-index, "
            "without + or #"
        )
