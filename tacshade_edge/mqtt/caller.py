"""A client of a running daemon through the broker:
requests with their replies, and the daemon's retained values.
"""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

from paho.mqtt.reasoncodes import ReasonCode as MqttCode

from tacshade_edge.errors import DecodeError, DeviceError
from tacshade_edge.fixes import MESSAGE_SIZE_FIX
from tacshade_edge.mqtt.client import BrokerAddress
from tacshade_edge.mqtt.follower import Follower
from tacshade_edge.mqtt.packets import PACKET_TOO_LARGE
from tacshade_edge.quoting import escaped, quoted
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.wire.codec import decode_object

CONNECT_S = 5.0
_ERROR_CHARS_MAX: Final = 500


class MqttCaller(Follower):
    """One client of one daemon.

    `verb`: verb of the requests. `watched`: retained topics to follow, such as ``state``. Raises
    ConfigError (a host name or authority file that can never work).
    """

    def __init__(
        self, broker: BrokerAddress, *, sensor_id: str, verb: str, watched: tuple[str, ...]
    ) -> None:
        super().__init__(broker, self._hear, name=verb)
        self._sensor_id, self._verb = sensor_id, verb
        self._base = f"tacshade/{sensor_id}"
        self._results = f"{self._base}/res/{verb}"
        self._changed = threading.Condition()
        self._ready = False
        self._failure: Reason | None = None
        self._denied: MqttCode | None = None
        self._latest = {f"{self._base}/{topic}": b"" for topic in watched}
        self._asked = ""
        self._reply: dict[str, Any] | None = None
        self.follow((self._results, *self._latest))

    def start(self) -> None:
        """Connect. Raises DeviceError when no broker answers or it rejects us."""
        super().start()
        self.wait_for(lambda: self._ready or self._failure is not None, CONNECT_S)
        if not self._ready:
            reason = self._failure or Reason(
                ReasonCode.NO_ANSWER, f"no answer within {CONNECT_S:.0f} s"
            )
            raise DeviceError(f"{self._where}: {reason}; expected a broker", code=reason.code)

    def ask(self, body: Mapping[str, object], timeout_s: float) -> dict[str, Any]:
        """Send a request and return its result.

        Raises DeviceError (the daemon or the broker rejected it, or the daemon did not answer).
        """
        # Before the request is sent: the reply may come before `publish` returns.
        self._asked, self._denied, self._reply = secrets.token_hex(8), None, None
        payload = json.dumps({**body, "transaction": self._asked}).encode()
        # QoS 1: the broker's answer shows whether its access rules deny the request.
        self._session.publish(f"{self._base}/req/{self._verb}", payload, qos=1)
        answered = self.wait_for(
            lambda: self._reply is not None or self._denied is not None, timeout_s
        )
        if (denied := self._denied) is not None:
            found = f"{self._where}: rejects {self._base}/req/{self._verb}: {denied}"
            rules = (
                "change the broker's access rules (ACL) to allow this user to publish to this topic"
            )
            fix = MESSAGE_SIZE_FIX if denied.value == PACKET_TOO_LARGE else rules
            raise DeviceError(f"{found}; {fix}", code=ReasonCode.REFUSED)
        if not answered or (reply := self._reply) is None:
            found = (
                f"{self._where}: no answer from sensor {self._sensor_id} within {timeout_s:.0f} s"
            )
            raise DeviceError(f"{found}; is the daemon running?", code=ReasonCode.NO_ANSWER)
        match reply:
            case {"ok": True, "result": dict(result)}:
                return result
            case _:
                raise DeviceError(escaped(str(reply.get("error")), _ERROR_CHARS_MAX))

    def latest(self, topic: str) -> bytes:
        """Return the latest payload of a watched topic; empty before the first."""
        return self._latest.get(f"{self._base}/{topic}", b"")

    def wait_for(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until a received message makes `condition` true; return its last value."""
        deadline_s = time.monotonic() + timeout_s
        with self._changed:
            # In slices: a signal handler runs only between them.
            while not condition() and (left_s := deadline_s - time.monotonic()) > 0:
                self._changed.wait(min(left_s, 0.1))
            return condition()

    # -- called by the session, in paho's thread ---------------------------------------------------

    def _report(self, reason: Reason | None, fix: str = "") -> None:
        """Keep a failure for `start` to raise, in place of logging it."""
        with self._changed:
            self._failure = reason
            self._changed.notify_all()

    def _on_subscribed(self, codes: list[MqttCode]) -> None:
        super()._on_subscribed(codes)
        with self._changed:
            # Only now: without the subscription, the reply to a request would be lost.
            self._ready = self._failure is None
            self._changed.notify_all()

    def _on_answered(self, mid: int, code: MqttCode) -> None:
        with self._changed:
            self._denied = code if code.is_failure else None
            self._changed.notify_all()

    def _hear(self, topic: str, payload: bytes, _retained: bool) -> None:
        with self._changed:
            if topic == self._results:
                reply = decode_object(topic, payload)
                if reply.get("transaction") == self._asked:  # else it is another caller's
                    self._reply = reply
            elif topic in self._latest:
                self._latest[topic] = payload
            else:
                expected = ", ".join((self._results, *self._latest))
                raise DecodeError(f"found the topic {quoted(topic)}, expected one of {expected}")
            self._changed.notify_all()
