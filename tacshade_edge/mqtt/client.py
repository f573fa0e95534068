"""A paho client with the settings that this daemon needs; no policy about what it sends."""

from __future__ import annotations

import logging
import select
import socket
import ssl
import sys
from collections.abc import Callable
from types import MappingProxyType
from typing import Any, Final, TypedDict

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from tacshade_edge.errors import ConfigError, DecodeError

_log = logging.getLogger(__name__)

PACKET_TOO_LARGE: Final = 0x95
"""Reason code of MQTT 5."""
_REASON_CODES: Final = 256  # of one byte
_KEEPALIVE_S: Final = 10
_RECONNECT_DELAY_S: Final = 1
_CONNECT_TIMEOUT_S: Final = 3.0
_INCOMING_BYTES_MAX: Final = 65536
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


class BrokerSession(Client):
    """paho's client, which reconnects by itself and which no broker's message can end.

    `refused`: number of messages that `receive` dropped.
    """

    refused = 0

    def receive(self, on_message: Callable[[str, MQTTMessage], None]) -> None:
        """Hand every message to `on_message` with its topic,
        where U+FFFD replaces what is not UTF-8.

        If that raises DecodeError, the message is dropped and counted; the first one is logged.
        """

        def enter(_client: Client, _userdata: Any, message: MQTTMessage) -> None:
            try:
                on_message(topic_of(message), message)
            except DecodeError as error:
                if not self.refused:
                    _log.warning(
                        "%s: %s; dropped the message; further ones are only counted",
                        self.host,
                        error,
                    )
                self.refused += 1

        self.on_message = enter

    def answered(self, on_answer: Callable[[int, ReasonCode], None]) -> None:
        """Hand the id and reason code of every message that was sent (QoS 0) or answered
        (QoS 1) to `on_answer`.
        """

        def enter(
            _client: Client, _userdata: Any, mid: int, code: ReasonCode, _properties: Any
        ) -> None:
            on_answer(mid, code)

        self.on_publish = enter

    def step(self, timeout_s: float) -> bool:
        """Send and receive once; False without a connection.

        `Client.loop` would leave its socket pair open.
        """
        if (sock := self.socket()) is None:
            return False
        select.select([sock], [sock] if self.want_write() else [], [], timeout_s)
        for once in (self.loop_read, self.loop_write, self.loop_misc):
            if once() != MQTTErrorCode.MQTT_ERR_SUCCESS:
                return False
        return self.socket() is not None

    def stop(self) -> None:
        """Disconnect, and end the network thread."""
        self.disconnect()
        self.loop_stop()


def topic_of(message: MQTTMessage) -> str:
    """Return the topic of a message, where U+FFFD replaces what is not UTF-8."""
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


def connect_failure() -> tuple[BaseException | None, str]:
    """Return the error of a failed connection and its text, in `on_connect_fail`:
    paho does not pass it on.
    """
    error = sys.exception()
    return error, str(getattr(error, "strerror", None) or error or "no connection")


def make_client(broker: BrokerAddress, *, base_topic: str, client_id: str) -> BrokerSession:
    """Return a client that retries every second once its loop runs.

    It uses MQTT 5, since only a version 5 connection receives a request's response topic and
    correlation data; subscribers of version 3.1.1 still receive what it publishes.

    Raises ConfigError (a host name, topic or authority file that can never work).
    """
    tls_ca = broker["tls_ca"]
    _check(broker["host"], base_topic)
    _accept_any_answer()
    client = BrokerSession(
        CallbackAPIVersion.VERSION2, client_id=client_id, protocol=MQTTProtocolVersion.MQTTv5
    )
    client.reconnect_delay_set(_RECONNECT_DELAY_S, _RECONNECT_DELAY_S)
    client.connect_timeout = _CONNECT_TIMEOUT_S
    client.on_socket_open = _on_socket_open
    if broker["username"] is not None:
        client.username_pw_set(broker["username"], broker["password"])
    if tls_ca is not None:
        try:
            client.tls_set(ca_certs=tls_ca)
        except (OSError, ssl.SSLError) as error:
            raise ConfigError(
                f"CA certificate file {tls_ca}: {error.strerror or error}; expected a PEM file "
                "with certificates"
            ) from error
    return client


def connect(
    client: Client, host: str, port: int, *, incoming_bytes_max: int = _INCOMING_BYTES_MAX
) -> None:
    """Start the client's network thread, which connects and reconnects by itself.

    The broker never sends us a packet above `incoming_bytes_max`:
    requests are small, and memory is bounded.
    """
    client.connect_async(
        host, port, _KEEPALIVE_S, clean_start=True, properties=_limits(incoming_bytes_max)
    )
    client.loop_start()


def connect_now(
    client: Client,
    host: str,
    port: int,
    *,
    incoming_bytes_max: int = _INCOMING_BYTES_MAX,
    keepalive_s: int = _KEEPALIVE_S,
) -> None:
    """Connect without a thread: the caller makes the client read and write. Raises OSError."""
    client.connect(
        host, port, keepalive_s, clean_start=True, properties=_limits(incoming_bytes_max)
    )


def publish_properties(
    content_type: str,
    *,
    expiry_s: int | None = None,
    correlation: bytes | None = None,
    of_will: bool = False,
) -> Properties:
    """Return the MQTT 5 properties of a message or a last will;
    subscribers of version 3.1.1 do not see them.
    """
    properties = _properties(PacketTypes.WILLMESSAGE if of_will else PacketTypes.PUBLISH)
    properties.ContentType = content_type
    if expiry_s is not None:
        properties.MessageExpiryInterval = expiry_s
    if correlation is not None:
        properties.CorrelationData = correlation
    return _Packed(properties)


class _Packed(Properties):
    """Properties packed once: paho packs them again for every message,
    a third of its work per message.
    """

    def __init__(self, made: Properties) -> None:
        self.__dict__.update(made.__dict__, _packed=made.pack())  # type: ignore[no-untyped-call]

    def pack(self) -> bytes:
        """Return the same bytes as paho would."""
        packed: bytes = self.__dict__["_packed"]
        return packed


def packet_bytes(topic: str, payload: bytes, properties: Properties) -> int:
    """Return an upper bound of a message's size on the wire in bytes (MQTT 5, section 3.3)."""
    header, packet_id, length = 5, 2, 2
    packed: bytes = properties.pack()  # type: ignore[no-untyped-call]
    return header + length + len(topic.encode()) + packet_id + len(packed) + len(payload)


def packet_bytes_max(connack: Properties | None) -> int | None:
    """Return the largest packet in bytes that the broker accepts, from its CONNACK;
    None if it sets no bound.
    """
    return getattr(connack, "MaximumPacketSize", None)


def _limits(incoming_bytes_max: int) -> Properties:
    limits = _properties(PacketTypes.CONNECT)
    limits.MaximumPacketSize = incoming_bytes_max
    return limits


def _properties(packet_type: int) -> Properties:
    return Properties(packet_type)  # type: ignore[no-untyped-call]


def _on_socket_open(_client: Client, _userdata: Any, sock: Any) -> None:
    for name, value in _SOCKET_OPTIONS:
        if hasattr(socket, name):
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _check(host: str, base_topic: str) -> None:
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
