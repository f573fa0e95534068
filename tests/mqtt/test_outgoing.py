"""What is on its way to a broker, under any order of events;
the broker is a list of what paho was given.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.reasoncodes import ReasonCode

from support.patience import patience
from tacshade_edge.mqtt import outgoing
from tacshade_edge.mqtt.outgoing import Outgoing

S = 1_000_000_000
OK, NOBODY = (ReasonCode(PacketTypes.PUBACK, identifier=value) for value in (0, 0x10))


class FakeClient:
    """What `Outgoing` needs of a client; `held` has what paho has not yet sent, by number."""

    def __init__(self) -> None:
        self.held: dict[int, tuple[str, bytes, int]] = {}
        self.given = 0
        self.fails = False

    on_answer: Callable[[int, ReasonCode], None]

    def publish(self, topic: str, payload: bytes, qos: int, **_: object) -> SimpleNamespace:
        if self.fails:
            return SimpleNamespace(rc=MQTTErrorCode.MQTT_ERR_NO_CONN, mid=0)
        self.given += 1
        self.held[self.given] = topic, payload, qos
        return SimpleNamespace(rc=MQTTErrorCode.MQTT_ERR_SUCCESS, mid=self.given)

    def answer(self, code: ReasonCode = OK) -> tuple[str, bytes, int]:
        """Send the oldest, which the broker answers with this reason code."""
        mid = min(self.held)
        found = self.held.pop(mid)
        self.on_answer(mid, code)
        return found


class Side:
    def __init__(self) -> None:
        self.client = FakeClient()
        self.outcomes: list[tuple[int, str]] = []
        self.out = Outgoing(
            self.client, "b", "t", lambda _, seq, outcome: self.outcomes.append((seq, outcome))
        )  # type: ignore[arg-type]
        self.client.on_answer = self.out.answered
        self.out.set_retained("state", b"online")

    def connect(self) -> None:
        self.client.fails = False
        self.out.accepted(None)
        assert self.client.answer() == ("t/state", b"online", 1)

    def lose(self) -> None:
        self.client.held.clear()
        self.out.lost()


def test_an_answer_to_a_frame_does_not_end_the_wait_for_the_last_state() -> None:
    side = Side()
    side.connect()
    side.out.offer("height", b"0", 0)
    limit_s = patience(10)
    ending = threading.Thread(target=lambda: side.out.finish(b"stopped", limit_s))

    def answer_a_frame_while_the_other_thread_ends() -> None:
        ending.start()
        ending.join(0.2)  # its calls wait for this turn
        side.client.answer()
        ending.join(0.2)

    side.out.post(answer_a_frame_while_the_other_thread_ends)
    assert side.client.answer() == ("t/state", b"stopped", 1)
    ending.join(limit_s)
    assert not ending.is_alive()


@given(st.lists(st.sampled_from(["offer", "offer", "sent", "fails", "lost", "back"]), max_size=60))
def test_every_payload_has_one_outcome_and_the_newest_is_never_lost(events: list[str]) -> None:
    side, offered, sent = Side(), 0, [-1]
    for event in events:
        if event == "offer":
            side.out.offer("height", b"%d" % offered, offered)
            offered += 1
        elif event == "sent" and side.client.held:
            sent.append(int(side.client.answer()[1]))
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
    side.client.fails = False
    side.out.offer("height", b"%d" % offered, offered)
    while side.client.held:
        sent.append(int(side.client.answer()[1]))
    assert Counter(seq for seq, _ in side.outcomes) == Counter(range(offered + 1))
    assert sent == sorted(set(sent))
    assert sent[-1] == offered


def test_a_retained_value_is_sent_again_on_every_connection_and_only_the_newest() -> None:
    side = Side()
    for text in (b"old", b"new"):
        side.out.set_retained("info", text)
    for _ in range(3):
        side.connect()
        assert side.client.answer() == ("t/info", b"new", 1)
        assert not side.client.held
        side.lose()


def test_a_stream_asks_for_listeners_once_a_period_and_after_every_loss(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    side, now = Side(), [5]
    monkeypatch.setattr(outgoing.time, "monotonic_ns", lambda: now[0])
    side.connect()
    asked = []
    for now[0] in (5, 6, S - 1, S + 5, S + 6):
        side.out.offer("height", b"0", 0)
        asked.append(side.client.answer(NOBODY)[2])
        assert not side.out.has_listener("height")
    assert asked == [1, 0, 0, 1, 0]
    now[0] = 2 * S
    assert side.out.has_listener("height")  # time to ask again
    side.out.offer("height", b"0", 0)
    assert not side.out.has_listener(
        "height"
    )  # until another answer comes: else a frame is computed for nobody
    side.lose()
    side.connect()
    assert side.out.has_listener("height")
    assert [topic for topic, _, qos in side.client.held.values() if qos == 1] == ["t/height"]
