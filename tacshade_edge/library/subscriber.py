"""Results from a daemon on the network: messages are received when a result is requested,
in the caller's thread.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import select
import time
from typing import Any, Final

from paho.mqtt.client import MQTTMessage
from paho.mqtt.reasoncodes import ReasonCode as MqttCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from tacshade_edge.errors import ConfigError, DecodeError, DeviceError
from tacshade_edge.library.arguments import path_of, text_of, wrong
from tacshade_edge.library.frame_assembler import TOPICS, FrameAssembler
from tacshade_edge.library.result import Result, Results
from tacshade_edge.mqtt.client import (
    FRAMES_BYTES_MAX,
    BrokerAddress,
    BrokerSession,
    SessionEvents,
    broker_at,
    denial,
)
from tacshade_edge.quoting import escaped, quoted, shown
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.wire.broker_address import BROKER, host_and_port

_SILENT_S: Final = 5.0
"""A daemon with a camera publishes ten messages a second even while nothing touches."""
_STATES_S: Final = 1.0
# Anyone who reaches the broker may publish a state, and the error is one line.
_THERE_MAX: Final = 64
# Nobody answers the broker between two calls of `next`: a program may compute for a minute and a
# half before the broker ends the connection.
_KEEPALIVE_S: Final = 60
_POLL_S: Final = 0.1
_REASON_CHARS_MAX: Final = 500
_ID_CHARS_MAX: Final = 255
# U+FFFD stands for what was not UTF-8, which no sensor is named.
_STATE: Final = re.compile(r"tacshade/([^/\ufffd]+)/state")
_SENSOR_ID: Final = "the sensor_id of a daemon's settings, such as left-index"


def listen(
    broker: str,
    sensor_id: str,
    *,
    username: str | None = None,
    password: str | None = None,
    ca_file: str | os.PathLike[str] | None = None,
) -> Results:
    """Listen to a running daemon (docs/reference/mqtt.md).

    The daemon publishes a result for each frame in contact, for the end of a contact, and ten times
    a second while nothing touches. A slower reader gets the newest result; the others are passed
    over.

    Parameters
    ----------
    broker : str
        ``HOST`` or ``HOST:PORT``; the default port is 1883.
    sensor_id : str
        The `sensor_id` of the daemon's settings.
    username, password : str, optional
        Credentials for a broker that requires them.
    ca_file : path, optional
        Certificate of the authority that signed the broker's certificate;
        if given, the connection uses TLS.

    Returns
    -------
    Results
        An iterator without an end, already subscribed. It makes no thread: messages are received
        while ``next`` runs.

    Raises
    ------
    ConfigError
        The arguments can never work.
    DeviceError
        No broker answers, or the broker rejects the client. Later, from ``next``: no result arrived
        for 5 s, or the connection was lost; the next call connects again.
    """
    # A wildcard would mix the frames of several sensors into one stream.
    if not 0 < len(text_of("sensor_id", sensor_id, _SENSOR_ID)) <= _ID_CHARS_MAX or set(
        sensor_id
    ) & set("/+#"):
        raise wrong("sensor_id", sensor_id, _SENSOR_ID)
    address = _address(broker, username, password, ca_file)
    return _Heard(address, sensor_id)


def _address(
    broker: str,
    username: str | None,
    password: str | None,
    ca_file: str | os.PathLike[str] | None,
) -> BrokerAddress:
    host, port = host_and_port(text_of("broker", broker, BROKER))
    if password is not None and username is None:
        raise ConfigError("password: found a password without a username, expected both")
    return broker_at(
        host,
        port,
        username=None if username is None else text_of("username", username, "text"),
        password=None if password is None else text_of("password", password, "text"),
        tls_ca=None if ca_file is None else str(path_of("ca_file", ca_file)),
    )


class _Heard(Results):
    def __init__(self, broker: BrokerAddress, sensor_id: str) -> None:
        self._where, self._base = f"{broker['host']}:{broker['port']}", f"tacshade/{sensor_id}"
        self._failure = ""
        self._connected = False
        self._frames = FrameAssembler()
        # The sensors with a state, asked for after a silence.
        self._there: set[str] = set()
        events = SessionEvents(
            rejected=self._on_rejected, subscribed=self._on_subscribed, heard=self._on_message
        )
        self._client = BrokerSession(
            broker,
            events,
            client_id=f"tacshade-listen-{secrets.token_hex(6)}",
            base_topic=self._base,
            incoming_bytes_max=FRAMES_BYTES_MAX,
            keepalive_s=_KEEPALIVE_S,
        )
        self._client.follow({f"{self._base}/{topic}": SubscribeOptions(0) for topic in TOPICS})
        self._connect()

    @property
    def passed_over(self) -> int:
        return self._frames.passed_over

    @property
    def refused(self) -> int:
        return self._client.refused

    def _next(self) -> Result:
        if not self._connected:
            self._connect()
        end_s = time.monotonic() + _SILENT_S
        while time.monotonic() < end_s:
            # Without a wait once a frame is whole: only what has already arrived may replace it.
            if not self._step(0.0 if self._frames.whole else _POLL_S):
                raise self._lost(self._failure or "connection lost", ReasonCode.LOST)
            # The newest frame wins: first read everything that has arrived.
            if (
                self._frames.whole
                and not self._waits()
                and (result := self._frames.take()) is not None
            ):
                return result
        raise self._silence()

    def _connect(self) -> None:
        self._failure = ""
        # Half of a frame from the last connection must not be completed by this one.
        self._frames.forget()
        try:
            self._client.open()
        except OSError as error:
            raise self._lost(f"{error.strerror or error}", ReasonCode.UNREACHABLE) from None
        end_s = time.monotonic() + _SILENT_S
        # Connected is subscribed: before that, silence would mean nothing.
        while not (self._connected or self._failure) and time.monotonic() < end_s:
            if not self._step(_POLL_S):
                break
        if not self._connected:
            code = ReasonCode.REFUSED if self._failure else ReasonCode.NO_ANSWER
            raise self._lost(self._failure or "the broker does not answer", code)

    def _step(self, timeout_s: float) -> bool:
        return self._client.step(0.0 if self._waits() else timeout_s)

    def _waits(self) -> bool:
        """Whether unread data is waiting."""
        sock: Any = self._client.socket()
        if sock is None:
            return False
        # Bytes that TLS has already decrypted: `select` sees only the socket, which has none left.
        pending = getattr(sock, "pending", None)
        return bool(pending and pending()) or bool(select.select([sock], [], [], 0)[0])

    def _release(self) -> None:
        self._connected = False
        with contextlib.suppress(OSError):
            self._client.disconnect()
        # Sends DISCONNECT and closes the socket: without it the broker would wait for our
        # keepalive.
        while self._step(0.0):
            pass

    def _lost(self, found: str, code: ReasonCode) -> DeviceError:
        self._release()
        return DeviceError(
            f"{self._where}: {found}; expected a broker that serves topics under {self._base}/",
            code=code,
        )

    def _silence(self) -> DeviceError:
        """The error for a long silence, with its cause as far as it is known."""
        state, reason = (
            shown(self._frames.state),
            escaped(self._frames.info.reason, _REASON_CHARS_MAX),
        )
        known = f"the sensor's state is {state}"
        if not self._frames.state:
            # Retained values come at once, so a second is enough to name who is there.
            self._client.subscribe("tacshade/+/state", 0)
            end_s = time.monotonic() + _STATES_S
            while time.monotonic() < end_s and self._step(_POLL_S):
                pass
            there = ", ".join(map(shown, sorted(self._there))) or "no sensor"
            known = f"no daemon has published a state, expected one of those that have: {there}"
        text = (
            f"{self._where}: {self._base}: no result for {_SILENT_S:.0f} s; "
            f"{known}{'; ' * bool(reason)}{reason}"
        )
        return DeviceError(text, code=ReasonCode.NO_ANSWER)

    # -- called by the session, in the caller's thread ---------------------------------------------

    def _on_rejected(self, text: str, _code: object) -> None:
        self._failure = text

    def _on_subscribed(self, codes: list[MqttCode]) -> None:
        self._failure = denial(codes)
        self._connected |= not self._failure

    def _on_message(self, topic: str, message: MQTTMessage) -> None:
        if topic.startswith(f"{self._base}/"):
            self._frames.add(topic.removeprefix(f"{self._base}/"), bytes(message.payload))
        elif found := _STATE.fullmatch(topic):
            if len(self._there) < _THERE_MAX:
                self._there.add(found[1])
        else:
            raise DecodeError(f"found the topic {quoted(topic)}, expected one below {self._base}/")
