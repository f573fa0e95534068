"""Takes back what a trial's sensors left on a broker: their retained messages."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Final

from paho.mqtt.reasoncodes import ReasonCode as MqttCode

from tacshade_edge.mqtt.client import BrokerAddress
from tacshade_edge.mqtt.follower import Follower

_QUIET_S: Final = 0.3
"""The broker sends retained messages at once: after this silence there are no more."""
_MOST_S: Final = 5.0


class _Forgetting(Follower):
    """Replaces each retained message by nothing."""

    def __init__(self, broker: BrokerAddress, sensors: Sequence[str]) -> None:
        super().__init__(broker, self._hear, name="forget")
        self._changed = threading.Condition()
        self._subscribed, self._waiting = False, 0
        self.follow([f"tacshade/{name}/#" for name in sensors])

    def run(self) -> None:
        """Forget all; give up a broker that does not answer."""
        self.start()
        until_s = time.monotonic() + _MOST_S
        with self._changed:
            while (left_s := until_s - time.monotonic()) > 0:
                came = self._changed.wait(min(left_s, _QUIET_S))
                if not came and self._subscribed and not self._waiting:
                    break
        self.stop()

    def _hear(self, topic: str, payload: bytes, retained: object) -> None:
        if retained and payload:
            with self._changed:
                self._waiting += 1
                self._changed.notify_all()
            self._session.publish(topic, b"", qos=1, retain=True)

    def _on_answered(self, mid: int, code: MqttCode) -> None:
        super()._on_answered(mid, code)
        with self._changed:
            self._waiting -= 1
            self._changed.notify_all()

    def _on_subscribed(self, codes: list[MqttCode]) -> None:
        super()._on_subscribed(codes)
        with self._changed:
            self._subscribed = True
            self._changed.notify_all()


def forget(broker: BrokerAddress, sensors: Sequence[str]) -> None:
    """Remove all retained messages below these sensors' topics, as far as the broker allows it."""
    _Forgetting(broker, sensors).run()
