"""Checks the broker: is it reachable, does it pass on the daemon's messages,
and is a daemon already connected?
"""

from __future__ import annotations

import socket
import ssl
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from paho.mqtt.reasoncodes import ReasonCode as MqttCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from tacshade_edge.doctor import Finding, Findings, fault, ok, warning
from tacshade_edge.doctor.machine import Process
from tacshade_edge.errors import DecodeError
from tacshade_edge.fixes import (
    CLIENTS_FIX,
    MESSAGE_SIZE_FIX,
    connect_fix,
    is_not_authorised,
    is_other_version,
    no_answer_fix,
    refusal_fix,
)
from tacshade_edge.mqtt.client import BrokerAddress, BrokerSession, SessionEvents, denial
from tacshade_edge.mqtt.client_id_guard import place_of
from tacshade_edge.wire.codec import decode_object

_CONNECT_S, _ANSWER_S = 3.0, 2.0
# Also the limit of paho for the TLS handshake.
_KEEPALIVE_S = 3
# Odd, so that the median is one of them.
_ROUNDS = 5
# More than a height map (25 KB); about a cloud of 2700 points. The listener for WebSockets of
# Debian 12 stalls from 4 KB on, which a small message would not show.
_MESSAGE_BYTES = 38_000
_HEADER_BYTES = 200
# A frame at 50 per second. Without TCP_NODELAY, small packets wait up to 40 ms for an
# acknowledgement (Nagle, and the delay of the receiver).
_SLOW_MS = 20.0
_REPORTED = ("state", "info", "instance", "health", "status/+")
_ROUND_TRIP = "broker round trip"


@dataclass(frozen=True, slots=True)
class DaemonState:
    """The retained messages that the broker holds from a daemon with this sensor's name."""

    state: str = ""  # `online`, `degraded`, `stopped`, `offline`; empty if there is none
    reason: str = ""  # why the daemon is not online
    fps: float = 0.0  # frames per second that it last delivered
    place: str = "in an unknown place"  # where it runs
    pid: int | None = None  # of its process, if it runs on this machine
    elsewhere: bool = False  # it runs on another machine
    rival: str = ""  # where another one runs that waits for the same name
    published: dict[str, bytes] = field(
        default_factory=dict, compare=False
    )  # all, by topic below the base topic

    @property
    def alive(self) -> bool:
        return self.state in ("online", "degraded")

    def __str__(self) -> str:
        return f"{self.state}, {self.fps:.1f} frames/s" + (
            f", {self.reason}" if self.reason else ""
        )


class _Session:
    """A connection as the daemon has it, but with a client id that the broker invents;
    it keeps what was answered.
    """

    def __init__(self, broker: BrokerAddress, base: str) -> None:
        self.base, self.topic = base, f"{base}/doctor"
        self.greeted = False
        self.rejection: MqttCode | None = None
        self.packet_bytes_max: int | None = None
        self.subscribed: list[MqttCode] = []
        self.published: MqttCode | None = None
        self.messages: dict[str, bytes] = {}
        events = SessionEvents(
            accepted=self._on_accepted,
            rejected=self._on_rejected,
            subscribed=lambda codes: setattr(self, "subscribed", codes),
            answered=lambda _mid, code: setattr(self, "published", code),
            heard=lambda topic, message: self.messages.update({topic: bytes(message.payload)}),
        )
        # An invented name: with its own, this connection would end the one of the daemon.
        self.client = BrokerSession(broker, events, client_id="", base_topic=base)
        # Of the daemon's QoS, and retained: a broker that allows neither refuses the connection.
        # Without content, it would leave nothing behind.
        self.client.will_set(self.topic, b"", qos=1, retain=True)

    def _on_accepted(self, bytes_max: int | None) -> None:
        self.greeted, self.packet_bytes_max = True, bytes_max

    def _on_rejected(self, _text: str, code: MqttCode) -> None:
        self.greeted, self.rejection = True, code

    @property
    def is_refused(self) -> bool:
        return self.published is not None and self.published.is_failure

    def pump(self, done: Callable[[], object]) -> bool:
        """Send and receive until `done`, the connection's end or 2 s;
        return whether the connection is still open.
        """
        deadline_s = time.monotonic() + _ANSWER_S
        # paho without its thread: here it is asked, so that nothing happens behind the check.
        while not done() and time.monotonic() < deadline_s:
            if not self.client.step(0.05):
                return False
        return True

    def subscribe(self) -> bool:
        """Subscribe to the daemon's topics and our own; return whether the broker lets us."""
        self.client.subscribe(
            # Only what is retained tells of a daemon; frames would delay the measurement.
            [(f"{self.base}/{name}", SubscribeOptions(1)) for name in ("doctor", *_REPORTED)]
        )
        self.pump(lambda: self.subscribed)
        return bool(self.subscribed) and not denial(self.subscribed)

    def echoes(self, size: int) -> bool:
        """Publish a message of `size` bytes to ourselves; return whether it came back."""
        self.published = None
        self.messages.pop(self.topic, None)
        # QoS 1, so that a refusal comes back: brokers drop QoS 0 without a word.
        self.client.publish(self.topic, bytes(size), qos=1)
        self.pump(lambda: self.topic in self.messages or self.is_refused)
        return self.messages.pop(self.topic, None) is not None


def check_broker(broker: BrokerAddress, sensor_id: str) -> tuple[Findings, DaemonState]:
    """Connect as the daemon does, and receive own messages the size of a height map;
    nothing is retained.
    """
    session = _Session(broker, f"tacshade/{sensor_id}")
    where, tls_ca = f"{broker['host']}:{broker['port']}", broker["tls_ca"]
    began_s = time.monotonic()
    trouble = _connect(session, broker) or _greet(session, where, broker["username"], tls_ca)
    if trouble is not None:
        session.client.disconnect()
        return (trouble,), DaemonState()
    took_ms = 1e3 * (time.monotonic() - began_s)
    first = ok(
        "broker",
        f"{where}: accepted the connection{' over TLS' if tls_ca else ''} in {took_ms:.0f} ms",
    )
    second = _round_trip(session, broker["username"])
    session.client.disconnect()
    return (first, second), _daemon_state(session)


def judge_daemon(daemon: DaemonState, process: Process | None, sensor_id: str) -> Finding:
    log = "see journalctl -u tacshade-edge"
    if daemon.alive and daemon.rival:
        found = (
            f"two daemons are using {sensor_id}: one is running {daemon.place}, "
            "and the other is waiting"
        )
        fix = "stop one of the two daemons, or give its sensor another sensor_id"
        return warning("daemon", f"{found} {daemon.rival}", fix)
    strange = process is not None and daemon.pid not in (None, process.pid)
    if daemon.alive and process is not None and (strange or daemon.elsewhere):
        found = f"{process} runs here, but {sensor_id} is {daemon.state} {daemon.place}"
        return warning("daemon", found, "run doctor there, or give this sensor another sensor_id")
    if process is None and daemon.alive:
        fix = "stop the other daemon, or give this sensor another sensor_id"
        return warning(
            "daemon",
            f"no daemon is running here, yet {sensor_id} is {daemon.state} on this broker",
            fix,
        )
    if process is None:
        return ok("daemon", "not running")
    if not daemon.alive:
        fix = f"was the daemon started with these settings? {log}"
        return warning(
            "daemon", f"{process} is running, but {sensor_id} is not online at the broker", fix
        )
    found = f"running, {process}: {daemon}"
    return ok("daemon", found) if daemon.state == "online" else warning("daemon", found, log)


def _connect(session: _Session, broker: BrokerAddress) -> Finding | None:
    host, port, tls_ca = broker["host"], broker["port"], broker["tls_ca"]
    try:
        # paho also hides why a certificate is not trusted.
        # First without paho, which leaves a socket open if its TLS handshake fails.
        with socket.create_connection((host, port), _CONNECT_S) as plain:
            if tls_ca is not None:
                context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
                context.load_verify_locations(tls_ca)
                context.wrap_socket(plain, server_hostname=host).close()
        session.client.connect(host, port, _KEEPALIVE_S, clean_start=True)
    except OSError as error:
        return fault(
            "broker", f"{host}:{port}: {_unreached(error)}", connect_fix(error, host, port, tls_ca)
        )
    return None


def _unreached(error: OSError) -> str:
    match error:
        case socket.gaierror():
            return f"the name does not resolve ({error.strerror})"
        case ssl.SSLCertVerificationError():
            return f"its certificate failed verification: {error.verify_message}"
        case ssl.SSLError():
            return f"does not answer over TLS ({error.reason or error})"
        case ConnectionRefusedError():
            return "connection refused: nothing is listening"
        case TimeoutError():
            return f"no answer within {_CONNECT_S:g} s"
    return str(error.strerror or error)


def _greet(
    session: _Session, where: str, username: str | None, tls_ca: str | None
) -> Finding | None:
    open_still = session.pump(lambda: session.greeted)
    code = session.rejection
    if not session.greeted:
        doing = "does not answer" if open_still else "hangs up"
        found = f"{where}: accepts connections but {doing}, so it is not an MQTT broker"
        fix = no_answer_fix(tls_ca)
        if not open_still:
            found += ", or has no room for another client"
            fix += f". If it is a broker, {CLIENTS_FIX}"
        return fault("broker", found, fix)
    if code is None:
        return None
    if is_not_authorised(code.value):
        whom = (
            "a connection without a user name"
            if username is None
            else f"the user {username} or the password"
        )
        found = f"rejects {whom} ({code})"
    else:
        found = (
            "does not speak MQTT 5"
            if is_other_version(code.value)
            else f"rejects the connection: {code}"
        )
    return fault("broker", f"{where}: {found}", refusal_fix(code.value, username))


def _round_trip(session: _Session, username: str | None) -> Finding:
    """Subscribe to the daemon's topics and our own, publish messages to ourselves and time them."""
    acl = (
        f"add two lines to the broker's ACL file: user {username or '(none)'}, then topic "
        "readwrite tacshade/#"
    )
    acl += " (see systemd/mosquitto-tacshade.acl)"
    below = f"topics under {session.base}/"
    if not session.subscribe():
        return fault(_ROUND_TRIP, f"the broker does not let this user subscribe to {below}", acl)
    # First without content: the broker may take messages, but none of this size. What a daemon has
    # left on the broker comes before the echo.
    echoed, most = session.echoes(0), session.packet_bytes_max
    if echoed and most is not None and most < _MESSAGE_BYTES + _HEADER_BYTES:
        return _limited(f"the broker accepts packets of at most {most} bytes")
    if not echoed:
        refused = f"the broker does not let this user publish to {below} ({session.published})"
        silent = f"a message to {session.topic} did not come back within {_ANSWER_S:g} s"
        return fault(_ROUND_TRIP, refused if session.is_refused else silent, acl)
    took_ms = []
    for _ in range(_ROUNDS):
        began_s = time.monotonic()
        if not session.echoes(_MESSAGE_BYTES):
            return _limited(
                f"a message of {_MESSAGE_BYTES} bytes did not come back within {_ANSWER_S:g} s"
            )
        took_ms.append(1e3 * (time.monotonic() - began_s))
    # The median: one of them meets a busy moment.
    return judge_round_trip(statistics.median(took_ms))


def _limited(found: str) -> Finding:
    return warning(
        _ROUND_TRIP, f"{found}; the daemon skips larger height maps and clouds", MESSAGE_SIZE_FIX
    )


def judge_round_trip(middle_ms: float) -> Finding:
    found = f"a {_MESSAGE_BYTES // 1000} KB message made the round trip in {middle_ms:.1f} ms"
    if middle_ms <= _SLOW_MS:
        return ok(_ROUND_TRIP, found)
    fix = (
        "add `set_tcp_nodelay true` to the broker's configuration (systemd/mosquitto-tacshade.conf)"
    )
    return warning(_ROUND_TRIP, found, f"{fix}, or connect by cable")


def _daemon_state(session: _Session) -> DaemonState:
    published = {
        topic.removeprefix(f"{session.base}/"): payload
        for topic, payload in session.messages.items()
    }
    names = ("health", "status/camera", "status/broker", "instance", "status/rival")
    health, camera, link, instance, rival = (_json(published.get(name, b"")) for name in names)
    # Whoever may publish here may publish anything: nothing of it is taken for granted.
    fps, pid = health.get("delivered_fps", 0.0), instance.get("process")
    here = instance.get("host") == socket.gethostname()
    return DaemonState(
        published.get("state", b"").decode(errors="replace")[:20],
        str(camera.get("reason") or link.get("reason") or health.get("degraded_reason") or "")[
            :200
        ],
        float(fps) if isinstance(fps, int | float) else 0.0,
        place_of(instance),
        pid if here and isinstance(pid, int) else None,
        bool(instance.get("host")) and not here,
        place_of(rival) if rival else "",
        published,
    )


def _json(payload: bytes) -> dict[str, Any]:
    try:
        return decode_object("what a daemon publishes", payload or b"{}")
    except DecodeError:
        return {}
