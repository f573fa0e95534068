"""A subscriber whose topics can change at any time,
so that no sensor computes what nobody reads.
"""

from __future__ import annotations

import logging
import secrets
import threading
from collections.abc import Callable, Collection
from typing import Any, Final

from paho.mqtt.client import Client
from paho.mqtt.reasoncodes import ReasonCode as MqttCode

from tacshade_edge.fixes import BROKERS_LOG, connect_fix, refusal_fix, with_fix
from tacshade_edge.mqtt.client import BrokerAddress, connect, connect_failure, make_client
from tacshade_edge.reasons import Reason, ReasonCode

_log = logging.getLogger(__name__)

_INCOMING_BYTES_MAX: Final = 1 << 26
"""Bytes, more than any camera's `height` or `cloud`."""
_ACL_FIX: Final = "give this user access rules (ACL) that let it read tacshade/#"


class Follower:
    """A client of the broker that reconnects by itself and logs each failure in one line.

    `on_message`: ``on_message(topic, payload, retained)``, called in paho's thread; an exception
    leaves that thread. Raises ConfigError (a host name or authority file that can never work).
    """

    def __init__(
        self,
        broker: BrokerAddress,
        on_message: Callable[[str, bytes, bool], None],
        *,
        name: str = "bridge",
    ) -> None:
        self._broker, self._where = broker, f"{broker['host']}:{broker['port']}"
        self._lock = threading.Lock()
        self._topics: frozenset[str] = frozenset()
        self._connected = False
        self._logged: Reason | None = Reason(ReasonCode.STARTING, "not started")
        self._client = make_client(
            broker, base_topic="tacshade", client_id=f"tacshade-{name}-{secrets.token_hex(6)}"
        )
        self._client.on_connect = self._on_connect
        self._client.on_connect_fail = self._on_connect_fail
        self._client.on_disconnect = self._on_disconnect
        self._client.on_subscribe = self._on_subscribe
        self._client.receive(
            lambda topic, message: on_message(topic, bytes(message.payload), message.retain)
        )

    def start(self) -> None:
        """Start connecting, and keep trying until `stop`; an absent broker is no error."""
        connect(
            self._client,
            self._broker["host"],
            self._broker["port"],
            incoming_bytes_max=_INCOMING_BYTES_MAX,
        )

    def follow(self, topics: Collection[str]) -> None:
        """Follow these topics and no others from now on; callable from any thread."""
        with self._lock:
            wanted = frozenset(topics)
            new, old, self._topics = wanted - self._topics, self._topics - wanted, wanted
            if self._connected:  # else the next connection subscribes to all of them
                self._subscribe(new)
                if old:
                    self._client.unsubscribe(sorted(old))

    def stop(self) -> None:
        """Disconnect."""
        self._client.stop()

    def _subscribe(self, topics: Collection[str]) -> None:
        # With QoS 1 a broker queues messages until they are acknowledged and drops those beyond its
        # queue: of many retained messages, all except the first 40.
        if topics:
            self._client.subscribe([(topic, 0) for topic in sorted(topics)])

    def _report(self, reason: Reason | None, fix: str = "") -> None:
        """Log a change, not a repetition; None is connected."""
        if reason == self._logged:
            return
        self._logged = reason
        if reason is None:
            _log.info("%s: connected", self._where)
        else:
            _log.warning("%s: %s", self._where, with_fix(reason, fix))

    # -- called by paho, in its thread -------------------------------------------------------------

    def _on_connect(
        self, _client: Client, _userdata: Any, _flags: Any, code: MqttCode, _properties: Any
    ) -> None:
        if code.is_failure:
            fix = refusal_fix(code.value, self._broker["username"])
            self._report(Reason(ReasonCode.REFUSED, f"rejects the connection: {code}"), fix)
            return
        self._report(None)
        with self._lock:
            self._connected = True
            self._subscribe(self._topics)

    def _on_connect_fail(self, _client: Client, _userdata: Any) -> None:
        error, text = connect_failure()
        fix = connect_fix(error, self._broker["host"], self._broker["port"], self._broker["tls_ca"])
        self._report(Reason(ReasonCode.UNREACHABLE, text), fix)

    def _on_disconnect(
        self, _client: Client, _userdata: Any, _flags: Any, code: MqttCode, _properties: Any
    ) -> None:
        with self._lock:
            was, self._connected = self._connected, False
        if was:
            self._report(Reason(ReasonCode.LOST, f"connection lost ({code})"), BROKERS_LOG)

    def _on_subscribe(
        self, _client: Client, _userdata: Any, _mid: int, codes: list[MqttCode], _p: Any
    ) -> None:
        if refused := next((code for code in codes if code.is_failure), None):
            self._report(Reason(ReasonCode.REFUSED, f"rejects a subscription: {refused}"), _ACL_FIX)
