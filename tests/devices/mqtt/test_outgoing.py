"""What is on its way to a broker, under any order of events; the broker is a list of what it was given."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.reasoncodes import ReasonCode

from tacshade_edge.devices.mqtt import outgoing
from tacshade_edge.devices.mqtt.outgoing import Outgoing

S = 1_000_000_000
OK, NOBODY = (ReasonCode(PacketTypes.PUBACK, identifier=value) for value in (0, 0x10))


class FakeClient:
    """What `Outgoing` needs of a client; `held` has what the broker has not answered yet, by number, `sent` all."""

    refused = 0

    def __init__(self) -> None:
        self.held: dict[int, tuple[str, bytes, int]] = {}
        self.sent: list[tuple[str, bytes, int]] = []
        self.given = 0
        self.fails = False
        self.room = 1 << 30
        self.written = b""

    def answered(self, on_answer: Any) -> None:
        self.on_answer = on_answer

    def wake(self) -> None:
        pass

    def queued(self) -> bool:
        return False

    def send(self, data: memoryview) -> int:
        """Take what there is room for; a whole packet is sent."""
        taken = data[: self.room]
        self.room -= len(taken)
        self.written += taken
        if len(taken) == len(data):
            self.sent.append(topic_and_payload(self.written))
            self.written = b""
        return len(taken)

    def publish(self, topic: str, payload: bytes, qos: int, *_: object) -> SimpleNamespace:
        if self.fails:
            return SimpleNamespace(rc=MQTTErrorCode.MQTT_ERR_NO_CONN, mid=0)
        self.given += 1
        self.held[self.given] = topic, payload, qos
        self.sent.append((topic, payload, qos))
        return SimpleNamespace(rc=MQTTErrorCode.MQTT_ERR_SUCCESS, mid=self.given)

    def answer(self, code: ReasonCode = OK) -> tuple[str, bytes, int]:
        """Send the oldest, which the broker answers with this reason code."""
        mid = min(self.held)
        found = self.held.pop(mid)
        self.on_answer(mid, code)
        return found


def topic_and_payload(packet: bytes) -> tuple[str, bytes, int]:
    """Of a PUBLISH with QoS 0 and less than 128 bytes of properties."""
    first, at, size = packet[0], 1, 0
    while True:
        size |= (packet[at] & 127) << 7 * (at - 1)
        at += 1
        if packet[at - 1] < 128:
            break
    assert (first, size) == (0x30, len(packet) - at)
    end = at + 2 + int.from_bytes(packet[at : at + 2], "big")
    return packet[at + 2 : end].decode(), packet[end + 1 + packet[end] :], 0


class Side:
    """Payloads on their way, and what the network thread does with them."""

    def __init__(self) -> None:
        self.client = FakeClient()
        self.outcomes: list[tuple[int, str]] = []
        self.out = Outgoing(self.client, "b", "t", lambda _, seq, outcome: self.outcomes.append((seq, outcome)))  # type: ignore[arg-type]
        self.out.set_retained("state", b"online")

    def connect(self) -> None:
        self.client.fails = False
        self.out._accepted(None)
        self.out._write()
        assert self.answer() == ("t/state", b"online", 1)

    def answer(self, code: ReasonCode = OK) -> tuple[str, bytes, int]:
        found = self.client.answer(code)
        self.out._write()
        return found

    def offer(self, seq: int) -> None:
        self.out.offer({"height": b"%d" % seq}, seq)
        self.out._write()

    def lose(self) -> None:
        self.client.held.clear()
        self.client.written = b""
        self.out._lost()


EVENTS = ("offer", "offer", "answered", "full", "room", "fails", "lost", "back")


@given(st.lists(st.sampled_from(EVENTS), max_size=60))
def test_every_payload_has_one_outcome_and_the_newest_is_never_lost(events: list[str]) -> None:
    side, offered = Side(), 0
    for event in events:
        if event == "offer":
            side.offer(offered)
            offered += 1
        elif event == "answered" and side.client.held:
            side.answer()
        elif event in ("full", "room"):
            side.client.room = 9 if event == "full" else 1 << 30
            side.out._write()
        elif event == "fails":
            side.client.fails = True
        elif event == "lost":
            side.lose()
        elif event == "back" and not side.out.connected:
            side.connect()
        assert len(side.client.held) <= 2
        assert all(seq < offered - 1 or outcome == "published" for seq, outcome in side.outcomes)
    if not side.out.connected:
        side.connect()
    side.client.fails, side.client.room = False, 1 << 30
    side.offer(offered)
    while side.client.held:
        side.answer()
    assert Counter(seq for seq, _ in side.outcomes) == Counter(range(offered + 1))
    sent = [int(payload) for topic, payload, _ in side.client.sent if topic == "t/height"]
    assert sent == sorted(sent)
    assert sent[-1] == offered


def test_the_payloads_of_a_frame_are_written_whole_one_after_the_other_as_the_socket_takes_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(outgoing.time, "monotonic_ns", lambda: 5)
    side, payloads = Side(), {"height": bytes(70_000), "cloud": bytes(200)}
    side.connect()
    side.out.offer(payloads, 0)  # with QoS 1: the first of its size, which also asks for listeners
    side.out._write()
    while side.client.held:
        side.answer()
    side.client.sent.clear()
    side.client.room = 0
    side.out.offer(payloads, 1)
    for step in (50, 60_000, 1, 10_000, 99, 1 << 20):
        assert side.out._write()
        side.client.room = step
    assert not side.out._write()
    assert side.client.sent == [(f"t/{stream}", payload, 0) for stream, payload in payloads.items()]
    assert side.outcomes == [(0, "published")] * 2 + [(1, "published")] * 2


def test_a_retained_value_is_sent_again_on_every_connection_and_only_the_newest() -> None:
    side = Side()
    for text in (b"old", b"new"):
        side.out.set_retained("info", text)
    for _ in range(3):
        side.connect()
        assert side.answer() == ("t/info", b"new", 1)
        assert not side.client.held
        side.lose()


def test_a_stream_asks_for_listeners_once_a_period_and_after_every_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    side, now = Side(), [5]
    monkeypatch.setattr(outgoing.time, "monotonic_ns", lambda: now[0])
    side.connect()
    asked = []
    for now[0] in (5, 6, S - 1, S + 5, S + 6):
        side.offer(0)
        asked.append(side.client.sent[-1][2])
        if side.client.held:
            side.answer(NOBODY)
        assert not side.out.has_listener("height")
    assert asked == [1, 0, 0, 1, 0]
    now[0] = 2 * S
    assert side.out.has_listener("height")  # time to ask again
    side.offer(0)
    assert not side.out.has_listener("height")  # until another answer comes: else a frame is computed for nobody
    side.lose()
    side.connect()
    assert side.out.has_listener("height")
    assert [topic for topic, _, qos in side.client.held.values() if qos == 1] == ["t/height"]
