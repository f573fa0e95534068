"""A subscriber whose topics can change at any time,
so that no sensor computes what nobody reads.
"""

from __future__ import annotations

import logging
import secrets
from collections.abc import Callable, Collection
from typing import Final

from paho.mqtt.reasoncodes import ReasonCode as MqttCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from tacshade_edge.fixes import BROKERS_LOG, connect_fix, refusal_fix, with_fix
from tacshade_edge.mqtt.client import (
    FRAMES_BYTES_MAX,
    BrokerAddress,
    BrokerSession,
    SessionEvents,
    denial,
)
from tacshade_edge.reasons import Reason, ReasonCode

_log = logging.getLogger(__name__)

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
        self._logged: Reason | None = Reason(ReasonCode.STARTING, "not started")
        events = SessionEvents(
            accepted=lambda _: self._report(None),
            rejected=self._on_rejected,
            unreachable=self._on_unreachable,
            lost=self._on_lost,
            subscribed=self._on_subscribed,
            answered=self._on_answered,
            heard=lambda topic, message: on_message(topic, bytes(message.payload), message.retain),
        )
        self._session = BrokerSession(
            broker,
            events,
            client_id=f"tacshade-{name}-{secrets.token_hex(6)}",
            incoming_bytes_max=FRAMES_BYTES_MAX,
        )

    def start(self) -> None:
        """Start connecting, and keep trying until `stop`; an absent broker is no error."""
        self._session.start()

    def follow(self, topics: Collection[str]) -> None:
        """Follow these topics and no others from now on; callable from any thread."""
        # With QoS 1 a broker queues messages until they are acknowledged and drops those beyond its
        # queue: of many retained messages, all except the first 40.
        self._session.follow(dict.fromkeys(sorted(topics), SubscribeOptions(0)))

    def stop(self) -> None:
        """Disconnect."""
        self._session.stop()

    def _report(self, reason: Reason | None, fix: str = "") -> None:
        """Log a change, not a repetition; None is connected."""
        if reason == self._logged:
            return
        self._logged = reason
        if reason is None:
            _log.info("%s: connected", self._where)
        else:
            _log.warning("%s: %s", self._where, with_fix(reason, fix))

    # -- called by the session, in paho's thread ---------------------------------------------------

    def _on_rejected(self, text: str, code: MqttCode) -> None:
        fix = refusal_fix(code.value, self._broker["username"])
        self._report(Reason(ReasonCode.REFUSED, text), fix)

    def _on_unreachable(self, error: BaseException | None, text: str) -> None:
        fix = connect_fix(error, self._broker["host"], self._broker["port"], self._broker["tls_ca"])
        self._report(Reason(ReasonCode.UNREACHABLE, text), fix)

    def _on_lost(self, code: MqttCode) -> None:
        self._report(Reason(ReasonCode.LOST, f"connection lost ({code})"), BROKERS_LOG)

    def _on_subscribed(self, codes: list[MqttCode]) -> None:
        if denied := denial(codes):
            self._report(Reason(ReasonCode.REFUSED, denied), _ACL_FIX)

    def _on_answered(self, mid: int, code: MqttCode) -> None:
        """Hear of a message that was sent; a follower sends none."""
