"""A link to a real broker whose requests and outcomes are kept."""

from __future__ import annotations

import queue
from collections import Counter, defaultdict
from typing import Any

from support.patience import wait_until
from tacshade_edge.devices.mqtt.link import MqttLink
from tacshade_edge.protocol.messages import Request
from tacshade_edge.reasons import ReasonCode

BASE = "tacshade/test"


class Rig:
    """A link whose requests and outcomes are kept."""

    def __init__(self, port: int, **options: Any) -> None:
        self.requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self.outcomes: dict[str, list[tuple[int, str]]] = defaultdict(list)
        self.link = MqttLink(
            host="127.0.0.1",
            port=port,
            base_topic=BASE,
            client_id="tacshade-test",
            on_request=self.requests.put,
            on_outcome=lambda stream, seq, outcome: self.outcomes[stream].append((seq, outcome)),
            **options,
        )

    def connect(self) -> Rig:
        self.link.start()
        wait_until(lambda: self.link.connected, 10, "connected")
        return self

    def counts(self, stream: str) -> Counter[str]:
        return Counter(outcome for _, outcome in list(self.outcomes[stream]))


def code(rig: Rig) -> ReasonCode | None:
    reason = rig.link.reason
    return reason.code if reason else None
