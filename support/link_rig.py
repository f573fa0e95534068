"""A link to a real broker whose requests and outcomes are kept."""

from __future__ import annotations

import queue
import threading
from collections import Counter, defaultdict
from typing import Any

from support.mqtt_rig import Subscriber
from support.patience import promised, wait_until
from tacshade_edge.mqtt.client import broker_at
from tacshade_edge.mqtt.link import MqttLink
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.wire.requests import Request

BASE = "tacshade/test"


class Rig:
    """A link whose requests and outcomes are kept."""

    def __init__(self, port: int, **options: Any) -> None:
        self.requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self.outcomes: dict[str, list[tuple[int, str]]] = defaultdict(list)
        self.link = MqttLink(
            broker_at("127.0.0.1", port, **options),
            base_topic=BASE,
            client_id="tacshade-test",
            on_request=self.requests.put,
            on_outcome=lambda stream, seq, outcome: self.outcomes[stream].append((seq, outcome)),
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


BACK_S = 3.0


def offer_for(rig: Rig, seconds: float, fps: int = 60, size: int = 38_000, first: int = 0) -> int:
    """Offer fresh payloads at a steady rate, each begins with its number; how many."""
    pause = threading.Event()
    count = round(seconds * fps)
    for seq in range(first, first + count):
        rig.link.offer("height", seq.to_bytes(4, "big") + bytes(size), seq)
        pause.wait(1 / fps)
    return count


def numbers(subscriber: Subscriber) -> list[int]:
    return [int.from_bytes(p[:4], "big") for p in subscriber.of(f"{BASE}/height")]


def come_back(rig: Rig, subscriber: Subscriber, seq: int) -> None:
    """From the broker's return: frames are offered until one is received, within 3 s."""
    have = len(numbers(subscriber))

    def received() -> bool:
        nonlocal seq
        rig.link.offer("height", seq.to_bytes(4, "big"), seq)
        seq += 1
        return len(numbers(subscriber)) > have

    promised(received, BACK_S, "the stream is back")
