"""Find out who holds a sensor's name at the broker before each connection,
since connecting takes it from the holder.

A broker gives a client ID to the newest connection. Two daemons with one `sensor_id` would take it
from each other forever, so a daemon that finds another one waits until that is gone, and reports
it.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
import time
from collections.abc import Callable
from typing import Any, Final

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.reasoncodes import ReasonCode as MqttCode

from tacshade_edge.errors import DecodeError
from tacshade_edge.mqtt.client import BrokerSession, connect_now, publish_properties
from tacshade_edge.quoting import shown
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.wire.codec import decode_object
from tacshade_edge.wire.messages import encode_status

_ANSWER_S: Final = 2.0
_UNKNOWN_S: Final = 0.3  # a broker without retained values of this name sends nothing
_LIFE_S: Final = 3.0  # three times the period of `health`
_GONE_S: Final = (
    10.0  # time for a restarted holder or broker to restore the name before another takes it
)
_POLL_S: Final = 0.05
_ALIVE: Final = (b"online", b"degraded")


def new_instance() -> dict[str, str | int]:
    """Return what distinguishes this daemon from another of the same name:
    retained as ``instance``.
    """
    return {"id": secrets.token_hex(8), "host": socket.gethostname(), "process": os.getpid()}


class ClientIdGuard:
    """A watch on a name over a connection with another one; only the link's paho thread uses it.

    `client`: without a client ID, not connected. `instance`: this daemon's `new_instance`.
    """

    def __init__(
        self,
        client: BrokerSession,
        host: str,
        port: int,
        base_topic: str,
        instance: dict[str, str | int],
    ) -> None:
        self._client, self._host, self._port, self._base = client, host, port, base_topic
        self._instance = instance
        self._rival = f"{base_topic}/status/rival"
        self._waited = False
        self._forget()
        client.on_connect, client.on_subscribe = self._on_connect, self._on_subscribe
        client.receive(self._on_message)

    def _forget(self) -> None:
        self._asked: bool = False  # whether the broker accepted the query
        self._living: bool = False  # whether something came that was not retained
        self._reported: bool = False
        self._state: bytes | None = None
        self._holder: dict[str, Any] = {}
        self._seen_s = 0.0

    def wait_until_gone(
        self, report: Callable[[Reason], None], stopped: Callable[[], bool]
    ) -> None:
        """Return when the name may be taken, at once if nobody holds it, or when `stopped`.

        It also returns if the broker rejects the query: connecting will show why.

        `report`: receives the reason, which names the holder, repeatedly. Raises OSError (no
        connection, or it was lost; call again).
        """
        self._forget()
        self._client.will_set(self._rival, b"", qos=1, retain=True)
        try:
            connect_now(self._client, self._host, self._port)
            end_s = time.monotonic() + _ANSWER_S
            while (
                not self._asked
                and not stopped()
                and time.monotonic() < end_s
                and self._client.step(_POLL_S)
            ):
                pass
            if not self._asked:
                return
            self._seen_s = time.monotonic()
            while not stopped() and not self._is_free(report):
                if not self._client.step(_POLL_S):
                    raise ConnectionResetError("connection lost")
            self._waited &= stopped()
        finally:
            if self._reported:
                self._client.publish(self._rival, b"", 0, True)
            self._client.disconnect()
            if (sock := self._client.socket()) is not None:
                with contextlib.suppress(OSError):
                    sock.shutdown(socket.SHUT_RDWR)  # type: ignore[attr-defined]
            while self._client.step(_POLL_S):  # reads to the end of the stream, and closes
                pass

    def _is_free(self, report: Callable[[Reason], None]) -> bool:
        """Whether nobody else holds the name, as far as is known now."""
        quiet_s = time.monotonic() - self._seen_s
        if self._state not in _ALIVE:
            return quiet_s >= (
                _GONE_S if self._waited else _UNKNOWN_S if self._state is None else 0.0
            )
        if self._holder.get("id") == self._instance["id"]:
            return True
        if not self._living:  # retained values of a daemon that died unnoticed
            return quiet_s >= _LIFE_S
        self._waited = True
        found = f"another daemon, {place_of(self._holder)}, is using {self._base}"
        report(reason := Reason(ReasonCode.IN_USE, f"{self._host}:{self._port}: {found}"))
        if not self._reported:
            self._reported = True
            status = encode_status("waiting", reason, self._instance)
            self._client.publish(
                self._rival, status, 0, True, publish_properties("application/json")
            )
        return False

    def _on_connect(
        self, client: Client, _userdata: Any, _flags: Any, code: MqttCode, _properties: Any
    ) -> None:
        if not code.is_failure:
            client.subscribe(
                [(f"{self._base}/{name}", 1) for name in ("state", "instance", "health")]
            )

    def _on_subscribe(self, *_: Any) -> None:
        self._asked = True

    def _on_message(self, topic: str, message: MQTTMessage) -> None:
        name, payload = topic.removeprefix(f"{self._base}/"), bytes(message.payload)
        self._living |= not message.retain
        if name == "state":
            self._state, self._seen_s = payload, time.monotonic()
        elif name == "instance":
            try:
                self._holder = decode_object(name, payload)
            except DecodeError:
                self._holder = {}


def place_of(instance: dict[str, Any]) -> str:
    """Return where an instance runs, for a person."""
    host, process = instance.get("host"), instance.get("process")
    return f"on {shown(host, 64)}, process {shown(process, 20)}" if host else "in an unknown place"
