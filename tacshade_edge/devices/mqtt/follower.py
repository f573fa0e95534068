"""A subscriber whose topics can change at any time, so that no sensor computes what nobody reads."""

from __future__ import annotations

import logging
import secrets
import threading
from collections.abc import Callable, Collection
from typing import Any, Final

from paho.mqtt.client import Client
from paho.mqtt.reasoncodes import ReasonCode as MqttCode

from tacshade_edge.devices.fixes import BROKERS_LOG, connect_fix, refusal_fix
from tacshade_edge.devices.mqtt.client import BrokerAddress, connect, connect_failure, make_client

_log = logging.getLogger(__name__)

_INCOMING_BYTES_MAX: Final = 1 << 26
"""Bytes, more than any camera's `height` or `cloud`."""


class Follower:
    """A client of the broker that reconnects by itself and logs each failure in one line. `on_message`:
    ``on_message(topic, payload, retained)``, called in paho's thread; an exception leaves that thread. Raises
    ConfigError (a host name or authority file that can never work).
    """

    def __init__(self, broker: BrokerAddress, on_message: Callable[[str, bytes, bool], None]) -> None:
        self._where, self._address = f"{broker['host']}:{broker['port']}", (broker["host"], broker["port"])
        self._username, self._tls_ca = broker["username"], broker["tls_ca"]
        self._lock = threading.Lock()
        self._topics: frozenset[str] = frozenset()
        self._connected = False
        self._logged = ""
        self._client = make_client(broker, base_topic="tacshade", client_id=f"tacshade-bridge-{secrets.token_hex(6)}")
        self._client.on_connect = self._on_connect
        self._client.on_connect_fail = self._on_connect_fail
        self._client.on_disconnect = self._on_disconnect
        self._client.on_subscribe = self._on_subscribe
        self._client.receive(lambda topic, message: on_message(topic, bytes(message.payload), message.retain))

    def start(self) -> None:
        """Start connecting, and keep trying until `stop`; an absent broker is no error."""
        connect(self._client, *self._address, incoming_bytes_max=_INCOMING_BYTES_MAX)

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
        # With QoS 1 a broker queues messages until they are acknowledged and drops those beyond its queue: of many
        # retained messages, all except the first 40.
        if topics:
            self._client.subscribe([(topic, 0) for topic in sorted(topics)])

    def _log_once(self, text: str, fix: str = "") -> None:
        """Log a change, not a repetition. A text with a fix is a fault."""
        if text == self._logged:
            return
        self._logged = text
        if fix:
            _log.warning("%s: %s; to fix it: %s", self._where, text, fix)
        else:
            _log.info("%s: %s", self._where, text)

    # -- called by paho, in its thread ----------------------------------------------------------------------------

    def _on_connect(self, _client: Client, _userdata: Any, _flags: Any, code: MqttCode, _properties: Any) -> None:
        if code.is_failure:
            self._log_once(f"rejects the connection: {code}", refusal_fix(code.value, self._username))
        else:
            self._log_once("connected")
        with self._lock:
            self._connected = not code.is_failure
            if self._connected:
                self._subscribe(self._topics)

    def _on_connect_fail(self, _client: Client, _userdata: Any) -> None:
        error, text = connect_failure()
        self._log_once(f"{text}; trying again", connect_fix(error, *self._address, self._tls_ca))

    def _on_disconnect(self, _client: Client, _userdata: Any, _flags: Any, code: MqttCode, _properties: Any) -> None:
        with self._lock:
            was, self._connected = self._connected, False
        if was:
            self._log_once(f"connection lost ({code})", BROKERS_LOG)

    def _on_subscribe(self, _client: Client, _userdata: Any, _mid: int, codes: list[MqttCode], _p: Any) -> None:
        if refused := next((code for code in codes if code.is_failure), None):
            self._log_once(
                f"rejects a subscription: {refused}",
                "give this user access rules (ACL) that let it read tacshade/#",
            )
