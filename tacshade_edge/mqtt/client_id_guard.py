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

from paho.mqtt.client import MQTTMessage
from paho.mqtt.subscribeoptions import SubscribeOptions

from tacshade_edge.errors import DecodeError
from tacshade_edge.mqtt.client import BrokerAddress, BrokerSession, SessionEvents
from tacshade_edge.mqtt.packets import publish_properties
from tacshade_edge.quoting import shown
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.wire.codec import decode_object
from tacshade_edge.wire.messages import encode_status

_ANSWER_S: Final = 2.0
# A broker without retained values of this name sends nothing, so silence is the answer.
_UNKNOWN_S: Final = 0.3
# Three times the period of `health`.
_LIFE_S: Final = 3.0
# Time for a restarted holder or broker to restore the name before another takes it.
_GONE_S: Final = 10.0
_POLL_S: Final = 0.05
_ALIVE: Final = (b"online", b"degraded")


def new_instance() -> dict[str, str | int]:
    """Return what distinguishes this daemon from another of the same name:
    retained as ``instance``.
    """
    return {"id": secrets.token_hex(8), "host": socket.gethostname(), "process": os.getpid()}


class ClientIdGuard:
    """A watch on a name over a connection with another one; only the link's paho thread uses it.

    `instance`: this daemon's `new_instance`. Raises ConfigError, as a session does.
    """

    def __init__(
        self, broker: BrokerAddress, base_topic: str, instance: dict[str, str | int]
    ) -> None:
        self._where, self._base = f"{broker['host']}:{broker['port']}", base_topic
        self._instance = instance
        self._rival = f"{base_topic}/status/rival"
        self._waited = False
        self._forget()
        events = SessionEvents(subscribed=self._on_subscribed, heard=self._on_message)
        # Without a client id the broker invents one, and nobody loses theirs.
        self._session = BrokerSession(broker, events, client_id="", base_topic=base_topic)
        self._session.follow(
            {
                f"{base_topic}/{name}": SubscribeOptions(1)
                for name in ("state", "instance", "health")
            }
        )

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
        # If we die while we wait, the broker clears our report of a rival.
        self._session.will_set(self._rival, b"", qos=1, retain=True)
        try:
            self._session.open()
            end_s = time.monotonic() + _ANSWER_S
            while (
                not self._asked
                and not stopped()
                and time.monotonic() < end_s
                and self._session.step(_POLL_S)
            ):
                pass
            if not self._asked:
                return
            # From the answer on: before it, silence says nothing.
            self._seen_s = time.monotonic()
            while not stopped() and not self._is_free(report):
                if not self._session.step(_POLL_S):
                    raise ConnectionResetError("connection lost")
            self._waited &= stopped()
        finally:
            if self._reported:
                self._session.publish(self._rival, b"", retain=True)
            self._session.disconnect()
            if (sock := self._session.socket()) is not None:
                # Without it a peer that stalls would keep us in the loop below.
                with contextlib.suppress(OSError):
                    sock.shutdown(socket.SHUT_RDWR)  # type: ignore[attr-defined]
            while self._session.step(_POLL_S):  # reads to the end of the stream, and closes
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
        # Only a living daemon sends more than the broker has retained, at least its `health`.
        if not self._living:  # retained values of a daemon that died unnoticed
            return quiet_s >= _LIFE_S
        self._waited = True
        found = f"another daemon, {place_of(self._holder)}, is using {self._base}"
        report(reason := Reason(ReasonCode.IN_USE, f"{self._where}: {found}"))
        if not self._reported:
            self._reported = True
            status = encode_status("waiting", reason, self._instance)
            self._session.publish(
                self._rival,
                status,
                retain=True,
                properties=publish_properties("application/json"),
            )
        return False

    def _on_subscribed(self, _codes: object) -> None:
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
