"""Brokers that accept no large messages, whichever way they show it."""

from __future__ import annotations

import itertools
import logging
from pathlib import Path

import pytest
from support.hostile_broker import HostileBroker, packet
from support.link_rig import BASE, Rig, broker_test, code, needs_mosquitto

from tacshade_edge.devices.mqtt.client import packet_bytes, publish_properties
from tacshade_edge.devices.mqtt.outgoing import SizeLimit
from tacshade_edge.protocol.requests import Request
from tacshade_edge.reasons import ReasonCode
from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.patience import wait_until

S = 1_000_000_000
SMALL_ENOUGH = 8000


def test_a_limit_that_the_broker_announces() -> None:
    limit = SizeLimit()
    limit.connected(2000, 0)
    assert not limit.refuses(2000, 0)
    assert limit.why == ""
    assert limit.refuses(2001, 0)
    assert "at most 2000 bytes" in limit.why
    limit.connected(2000, S)
    assert limit.why
    limit.connected(None, 2 * S)
    assert limit.why == ""
    assert not limit.refuses(1 << 30, 2 * S)


def test_a_size_is_tried_once_on_a_connection() -> None:
    limit = SizeLimit()
    limit.connected(None, 0)
    assert limit.untried(25_000)
    limit.took(25_000)
    assert not limit.untried(25_000)
    assert limit.untried(25_001)
    limit.connected(None, 0)
    assert limit.untried(25_000)


def test_a_rejected_size_is_tried_again_after_a_minute_and_then_ever_more_rarely() -> None:
    limit = SizeLimit()
    limit.connected(None, 0)
    now = 0
    for pause_s in (60, 120, 240):
        limit.rejected(25_000, now)
        limit.rejected(20_000, now)
        assert limit.refuses(20_000, now + (pause_s - 1) * S)
        assert "25000 bytes as too large" in limit.why
        assert not limit.refuses(19_999, now + (pause_s - 1) * S)
        now += pause_s * S
        assert not limit.refuses(25_000, now)
        assert limit.why == ""


@pytest.mark.parametrize("said_so", [False, True])
def test_lost_connections_show_a_limit_once_they_follow_each_other(said_so: bool) -> None:
    limit = SizeLimit()
    for second, learned in enumerate((said_so, True)):
        limit.connected(None, second * S)
        limit.took(300)
        limit.lost([25_000, 1500], said_so, second * S + 1)
        assert limit.refuses(25_000, second * S + 1) == learned
        assert not limit.refuses(1500, second * S + 1)


@pytest.mark.parametrize(
    ("sizes", "proven", "after_s"),
    [([], 0, 0), ([900, 1000], 0, 0), ([25_000], 25_000, 0), ([25_000], 0, 4)],
)
def test_other_losses_show_none(sizes: list[int], proven: int, after_s: int) -> None:
    limit = SizeLimit()
    for second in range(0, 50, 5):
        limit.connected(None, second * S)
        limit.took(proven)
        limit.lost(sizes, False, (second + after_s) * S)
        assert not limit.refuses(1 << 20, (second + after_s) * S)


def test_an_acknowledged_message_clears_the_broker() -> None:
    limit = SizeLimit()
    limit.lost([25_000], False, 0)
    limit.took(25_000)
    limit.connected(None, S)
    limit.lost([26_000], False, S)
    assert not limit.refuses(26_000, S)


def offer_until(rig: Rig, size: int, outcome: str, first: int) -> int:
    """Offer heights until one has this outcome; return the next number."""
    numbers = itertools.count(first)

    def met() -> bool:
        rig.link.offer("height", bytes(size), next(numbers))
        return any(seq >= first and found == outcome for seq, found in list(rig.outcomes["height"]))

    wait_until(met, 15, outcome)
    return next(numbers)


@broker_test
@needs_mosquitto
class TestMosquitto:
    @pytest.mark.parametrize("option", ["message_size_limit 10000", "max_packet_size 10000"])
    def test_large_messages_are_refused_and_the_connection_stays(
        self, tmp_path: Path, caplog: pytest.LogCaptureFixture, option: str
    ) -> None:
        with Broker(tmp_path, more=(option,)) as broker, Subscriber(broker.port, f"{BASE}/#") as seen:
            rig = Rig(broker.port).connect()
            rig.link.set_retained("info", bytes(12_000))
            for seq, size in enumerate((38_000, 12_000, SMALL_ENOUGH, 38_000, SMALL_ENOUGH)):
                rig.link.offer("height", bytes(size), seq)
                wait_until(lambda seq=seq: rig.counts("height").total() == seq + 1, 5, "settled")
            rig.link.reply(Request("status"), bytes(38_000))
            rig.link.reply(Request("status"), b"small")
            seen.wait_for(f"{BASE}/res/status")
            assert [len(payload) for payload in seen.of(f"{BASE}/height")] == [SMALL_ENOUGH] * 2
            outcomes = [outcome for _, outcome in rig.outcomes["height"]]
            assert outcomes == ["refused", "refused", "published", "refused", "published"]
            wait_until(lambda: rig.link.counters()["refused"] == 5, 5, "the value and the reply are refused too")
            assert rig.link.counters()["losses"] == 0
            assert code(rig) is None
            assert rig.link.limited is not None
            assert rig.link.limited.code is ReasonCode.MESSAGE_SIZE_LIMIT
            rig.link.stop(2)
        told = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
        assert len(told) == 1
        assert f"{BASE}/info" in told[0]
        assert "raise message_size_limit and max_packet_size" in told[0]

    @pytest.mark.parametrize("extra", range(-9, 3))
    def test_the_largest_packet_is_told_from_the_first_that_is_too_large(self, tmp_path: Path, extra: int) -> None:
        """Never a connection lost, and no more than some bytes of the broker's bound given away."""
        with Broker(tmp_path, more=("max_packet_size 1000",)) as broker:
            rig = Rig(broker.port).connect()
            around = packet_bytes(f"{BASE}/contact", b"", publish_properties("application/json", expiry_s=5))
            for seq in range(2):  # with QoS 1, then 0
                rig.link.offer("contact", bytes(1000 - around + extra), seq)
                wait_until(lambda seq=seq: rig.counts("contact").total() == seq + 1, 5, "settled")
            assert rig.counts("contact") == {"published" if extra <= 0 else "refused": 2}
            rig.link.reply(Request("status"), b"")
            wait_until(lambda: rig.link.counters()["replies"] == 1, 5, "still connected")
            assert rig.link.counters()["losses"] == 0
            rig.link.stop(2)


@pytest.mark.parametrize("last", [b"", packet(0xE0, b"\x95\0")], ids=["silent", "told"])
def test_a_broker_that_ends_the_connection(last: bytes) -> None:
    with HostileBroker(bytes_max=10_000, last=last) as broker:
        rig = Rig(broker.port).connect()
        rig.link.set_retained("info", bytes(2000))
        following = offer_until(rig, 38_000, "refused", 0)
        losses = rig.link.counters()["losses"]
        assert losses == (1 if last else 2)
        assert rig.link.limited is not None
        assert rig.link.limited.code is ReasonCode.MESSAGE_SIZE_LIMIT
        offer_until(rig, SMALL_ENOUGH, "published", following)
        assert rig.link.counters()["losses"] == losses
        rig.link.stop(2)


def test_a_reason_code_that_paho_does_not_know() -> None:
    with HostileBroker(code=0xF0) as broker:
        rig = Rig(broker.port).connect()
        rig.link.offer("height", b"1", 0)
        wait_until(lambda: rig.counts("height")["refused"] == 1, 5, "refused")
        assert rig.link.counters() | {"connects": 1, "losses": 0} == rig.link.counters()
        assert rig.link.limited is None
        rig.link.stop(2)
