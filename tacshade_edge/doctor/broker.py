"""Checks the broker: is it reachable, does it pass on the daemon's messages, and is a daemon already connected?"""

from __future__ import annotations

import socket
import ssl
import statistics
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from paho.mqtt.client import Client
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.reasoncodes import ReasonCode as MqttCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from tacshade_edge.devices.fixes import (
    MESSAGE_SIZE_FIX,
    connect_fix,
    is_not_authorised,
    is_other_version,
    no_answer_fix,
    refusal_fix,
)
from tacshade_edge.devices.mqtt.client import BrokerAddress, Session, make_client, packet_bytes_max
from tacshade_edge.devices.mqtt.client_id_guard import place_of
from tacshade_edge.doctor import Finding, fault, ok, warning
from tacshade_edge.doctor.machine import Process
from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.codec import decode_object

_CONNECT_S = 3.0
_KEEPALIVE_S = 3  # also paho's limit for the TLS handshake
_ANSWER_S = 2.0
_ROUNDS = 6  # the first is a warm-up
_MESSAGE_BYTES = 38_000  # more than a height map (25 KB); about a cloud of 2700 points
_HEADER_BYTES = 200
_SLOW_MS = 20.0
_REPORTED = ("state", "info", "instance", "health", "status/+")
_ACL = (
    "add two lines to the broker's ACL file: user {user}, then topic readwrite tacshade/# "
    "(see systemd/mosquitto-tacshade.acl)"
)


@dataclass(frozen=True, slots=True)
class DaemonState:
    """The retained messages that the broker holds from a daemon with this sensor's name."""

    state: str = ""  # `online`, `degraded`, `stopped`, `offline`; empty if there is none
    reason: str = ""  # why the daemon is not online
    fps: float = 0.0  # frames per second that it last delivered
    place: str = "in an unknown place"  # where it runs
    rival: str = ""  # where another one runs that waits for the same name
    published: dict[str, bytes] = field(default_factory=dict, compare=False)  # all, by topic below the base topic

    @property
    def alive(self) -> bool:
        """Whether a daemon is connected now."""
        return self.state in ("online", "degraded")

    def __str__(self) -> str:
        return f"{self.state}, {self.fps:.1f} frames/s" + (f", {self.reason}" if self.reason else "")


@dataclass(slots=True)
class _Session:
    """The broker's answers so far."""

    greeting: MqttCode | None = None
    packet_bytes_max: int | None = None
    subscribed: list[MqttCode] = field(default_factory=list)
    published: MqttCode | None = None
    messages: dict[str, bytes] = field(default_factory=dict)
    echoed: bool = False

    @property
    def is_refused(self) -> bool:
        """Whether the broker rejected the last message."""
        return self.published is not None and self.published.is_failure


def check_broker(broker: BrokerAddress, sensor_id: str) -> tuple[tuple[Finding, ...], DaemonState]:
    """Connect as the daemon does, but with another client id, and receive its own messages the size of a height map.

    They go to ``tacshade/<sensor-id>/doctor``, which the daemon's access rules allow; nothing is retained.
    """
    base = f"tacshade/{sensor_id}"
    host, port, username, tls_ca = broker["host"], broker["port"], broker["username"], broker["tls_ca"]
    client = make_client(broker, base_topic=base, client_id="")  # the broker invents one
    session = _listen(client, f"{base}/doctor")
    where = f"{host}:{port}"
    began_s = time.monotonic()
    trouble = _connect(client, host, port, tls_ca) or _greet(client, session, where, username, tls_ca)
    if trouble is None:
        took_ms = 1e3 * (time.monotonic() - began_s)
        found = f"{where}: accepted the connection{' over TLS' if tls_ca else ''} in {took_ms:.0f} ms"
        first = ok("broker", found)
        second = _round_trip(client, session, base, username)
        client.disconnect()
        return (first, second), _daemon_state(session, base)
    client.disconnect()
    return (trouble,), DaemonState()


def judge_daemon(daemon: DaemonState, process: Process | None, sensor_id: str) -> Finding:
    """Judge whether a daemon is running and whether it is this machine's."""
    if daemon.alive and daemon.rival:
        found = f"one is running {daemon.place}, and the other is waiting {daemon.rival}"
        fix = "stop one of the two daemons, or give its sensor another sensor_id"
        return warning("daemon", f"two daemons are using {sensor_id}: {found}", fix)
    if daemon.alive and process is None:
        fix = "stop the other daemon, or give this sensor another sensor_id"
        return warning("daemon", f"no daemon is running here, yet {sensor_id} is {daemon.state} on this broker", fix)
    if process is None:
        return ok("daemon", "not running")
    if daemon.state == "online":
        return ok("daemon", f"running, {process}: {daemon}")
    fix = "see journalctl -u tacshade-edge"
    if daemon.state == "degraded":
        return warning("daemon", f"running, {process}: {daemon}", fix)
    fix = f"was the daemon started with these settings? {fix}"
    return warning("daemon", f"{process} is running, but {sensor_id} is not online at the broker", fix)


def _listen(client: Session, own_topic: str) -> _Session:
    session = _Session()

    def on_connect(_client: Client, _userdata: Any, _flags: Any, code: MqttCode, properties: Any) -> None:
        session.greeting, session.packet_bytes_max = code, packet_bytes_max(properties)

    def on_subscribe(_client: Client, _userdata: Any, _mid: int, codes: list[MqttCode], _properties: Any) -> None:
        session.subscribed = codes

    def on_answer(_mid: int, code: MqttCode) -> None:
        session.published = code

    def on_message(topic: str, message: Any) -> None:
        if topic == own_topic:
            session.echoed = True
        else:
            session.messages[topic] = bytes(message.payload)

    client.on_connect, client.on_subscribe = on_connect, on_subscribe
    client.answered(on_answer)
    client.receive(on_message)
    return session


def _connect(client: Client, host: str, port: int, tls_ca: str | None) -> Finding | None:
    """Open the connection; return what is wrong with it, or None.

    `_reach` connects before paho does, because paho leaves a socket open if its TLS handshake fails.
    """
    try:
        _reach(host, port, tls_ca)
        client.connect(host, port, _KEEPALIVE_S, clean_start=True)
    except OSError as error:
        return fault("broker", _unreached(error, host, port), connect_fix(error, host, port, tls_ca))
    return None


def _unreached(error: OSError, host: str, port: int) -> str:
    """Return why no connection came about, as the finding's text."""
    where = f"{host}:{port}"
    match error:
        case socket.gaierror():
            return f"{host}: the name does not resolve ({error.strerror})"
        case ssl.SSLCertVerificationError():
            return f"{where}: its certificate failed verification: {error.verify_message}"
        case ssl.SSLError():
            return f"{where}: does not answer over TLS ({error.reason or error})"
        case ConnectionRefusedError():
            return f"{where}: connection refused: nothing is listening"
        case TimeoutError():
            return f"{where}: no answer within {_CONNECT_S:g} s"
    return f"{where}: {error.strerror or error}"


def _reach(host: str, port: int, tls_ca: str | None) -> None:
    """Open and close a connection. Raises OSError."""
    with socket.create_connection((host, port), _CONNECT_S) as plain:
        if tls_ca is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            context.load_verify_locations(tls_ca)
            context.wrap_socket(plain, server_hostname=host).close()


def _greet(client: Client, session: _Session, where: str, username: str | None, tls_ca: str | None) -> Finding | None:
    """Wait for the broker's answer to CONNECT; return what is wrong with it, or None."""
    open_still = _pump(client, lambda: session.greeting is not None)
    code = session.greeting
    if code is None:
        doing = "does not answer" if open_still else "hangs up"
        found = f"{where}: accepts connections but {doing}, so it is not an MQTT broker"
        return fault("broker", found, no_answer_fix(tls_ca))
    if not code.is_failure:
        return None
    if is_not_authorised(code.value):
        whom = "a connection without a user name" if username is None else f"the user {username} or the password"
        found = f"rejects {whom} ({code})"
    else:
        found = "does not speak MQTT 5" if is_other_version(code.value) else f"rejects the connection: {code}"
    return fault("broker", f"{where}: {found}", refusal_fix(code.value, username))


def _round_trip(client: Client, session: _Session, base: str, username: str | None) -> Finding:
    """Subscribe to the daemon's topics and our own, publish messages to ourselves and time them."""
    topic = f"{base}/doctor"
    acl = _ACL.format(user=username or "(none)")
    client.subscribe([(f"{base}/{name}", SubscribeOptions(1)) for name in ("doctor", *_REPORTED)])
    _pump(client, lambda: session.subscribed)
    if not session.subscribed or any(code.is_failure for code in session.subscribed):
        return fault("broker round trip", f"the broker does not let this user subscribe to topics under {base}/", acl)
    most = session.packet_bytes_max
    if most is not None and most < _MESSAGE_BYTES + _HEADER_BYTES:
        return _limited(f"the broker accepts packets of at most {most} bytes")
    took_ms = []
    for _ in range(_ROUNDS):
        began_s = time.monotonic()
        if not _echoes(client, session, topic, _MESSAGE_BYTES):
            answer = session.published
            if (small := _largest_echoed(client, session, topic)) is not None:
                return _limited(f"the broker accepts a message of {small} bytes but none of {2 * small}")
            if session.is_refused:
                found = f"the broker does not let this user publish to topics under {base}/ ({answer})"
                return fault("broker round trip", found, acl)
            found = f"a message to {topic} did not come back within {_ANSWER_S:g} s"
            return fault(
                "broker round trip", found, f"allow the user to receive the message ({acl}), or use a faster network"
            )
        took_ms.append(1e3 * (time.monotonic() - began_s))
    return judge_round_trip(statistics.median(took_ms[1:]))


def _echoes(client: Client, session: _Session, topic: str, size: int) -> bool:
    """Publish a message of `size` bytes to ourselves; return whether it came back."""
    session.published, session.echoed = None, False
    client.publish(topic, bytes(size), qos=1)
    _pump(client, lambda: session.echoed or session.is_refused)
    return session.echoed


def _largest_echoed(client: Client, session: _Session, topic: str) -> int | None:
    """Return the largest size of `_MESSAGE_BYTES` / 2, / 4, ... that comes back; None if not even a small one does."""

    def echoes(size: int) -> bool:
        if not client.is_connected():  # the broker ends a connection that publishes too much
            _connect_again(client, session, topic)
        return _echoes(client, session, topic, size)

    smallest, *others = (_MESSAGE_BYTES >> count for count in range(6, 0, -1))
    if not echoes(smallest):
        return None
    return next((size for size in reversed(others) if echoes(size)), smallest)


def _connect_again(client: Client, session: _Session, topic: str) -> None:
    session.subscribed = []
    client.drop_out_messages()
    with suppress(OSError):
        client.reconnect()
        _pump(client, client.is_connected)
        client.subscribe(topic, options=SubscribeOptions(1))
        _pump(client, lambda: session.subscribed)


def _limited(found: str) -> Finding:
    return warning("broker round trip", f"{found}; the daemon skips larger height maps and clouds", MESSAGE_SIZE_FIX)


def judge_round_trip(middle_ms: float) -> Finding:
    """Judge whether the round trip of a 38 KB message is quick enough."""
    found = f"a {_MESSAGE_BYTES // 1000} KB message made the round trip in {middle_ms:.1f} ms"
    if middle_ms > _SLOW_MS:
        fix = (
            "add `set_tcp_nodelay true` to the broker's configuration (systemd/mosquitto-tacshade.conf), "
            "or connect by cable"
        )
        return warning("broker round trip", found, fix)
    return ok("broker round trip", found)


def _pump(client: Client, done: Callable[[], object]) -> bool:
    """Send and receive until `done`, the connection's end or 2 s; return whether the connection is still open."""
    deadline_s = time.monotonic() + _ANSWER_S
    while not done() and time.monotonic() < deadline_s:
        if client.loop(0.05) != MQTTErrorCode.MQTT_ERR_SUCCESS:
            return False
    return True


def _daemon_state(session: _Session, base: str) -> DaemonState:
    health, camera, link = (
        _json(session.messages.get(f"{base}/{name}", b"")) for name in ("health", "status/camera", "status/broker")
    )
    state = session.messages.get(f"{base}/state", b"").decode(errors="replace")[:20]
    fps = health.get("delivered_fps", 0.0)
    reason = camera.get("reason") or link.get("reason") or health.get("degraded_reason") or ""
    instance, rival = (_json(session.messages.get(f"{base}/{name}", b"")) for name in ("instance", "status/rival"))
    return DaemonState(
        state,
        str(reason)[:200],
        float(fps) if isinstance(fps, int | float) else 0.0,
        place_of(instance),
        place_of(rival) if rival else "",
        {topic.removeprefix(f"{base}/"): payload for topic, payload in session.messages.items()},
    )


def _json(payload: bytes) -> dict[str, Any]:
    try:
        return decode_object("what a daemon publishes", payload or b"{}")
    except DecodeError:
        return {}
