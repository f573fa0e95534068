"""Brokers that accept no large messages, whichever way they show it."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from support.hostile_broker import HostileBroker
from support.link_rig import BASE, Rig, code
from support.mqtt_rig import Broker, Subscriber
from support.patience import wait_until
from tacshade_edge.mqtt.packets import packet_bytes, publish_properties
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.wire.requests import Request

SMALL_ENOUGH = 8000


@pytest.mark.broker
@pytest.mark.parametrize("option", ["message_size_limit 10000", "max_packet_size 10000"])
def test_large_messages_are_refused_and_the_connection_stays(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, option: str
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
        wait_until(
            lambda: rig.link.counters()["refused"] == 5,
            5,
            "the value and the reply are refused too",
        )
        assert rig.link.counters()["losses"] == 0
        assert code(rig) is None
        assert rig.link.limited is not None
        assert rig.link.limited.code is ReasonCode.MESSAGE_SIZE_LIMIT
        rig.link.stop(2)
    reported = [
        record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING
    ]
    assert len(reported) == 1
    assert f"{BASE}/info" in reported[0]
    assert "raise message_size_limit and max_packet_size" in reported[0]


@pytest.mark.broker
def test_the_largest_packet_is_distinguished_from_the_first_that_is_too_large(
    tmp_path: Path,
) -> None:
    with Broker(tmp_path, more=("max_packet_size 1000",)) as broker:
        rig = Rig(broker.port).connect()
        around = packet_bytes(
            f"{BASE}/contact", b"", publish_properties("application/json", expiry_s=5)
        )
        for seq, extra in enumerate((-9, 0, 0, 1, 1, -1)):  # with QoS 1, then 0
            rig.link.offer("contact", bytes(1000 - around + extra), seq)
            wait_until(lambda seq=seq: rig.counts("contact").total() == seq + 1, 5, "settled")
        assert [outcome for _, outcome in rig.outcomes["contact"]] == [
            *["published"] * 3,
            *["refused"] * 2,
            "published",
        ]
        assert rig.link.counters()["losses"] == 0
        rig.link.stop(2)


@pytest.mark.parametrize("answer", [0x01, 0x89, 0xF0])
def test_a_reason_code_that_paho_does_not_know(answer: int) -> None:
    with HostileBroker(code=answer) as broker:
        rig = Rig(broker.port).connect()
        rig.link.offer("height", b"1", 0)
        outcome = "refused" if answer & 0x80 else "published"
        wait_until(lambda: rig.counts("height")[outcome] == 1, 5, outcome)
        assert rig.link.counters() | {"connects": 1, "losses": 0} == rig.link.counters()
        assert rig.link.limited is None
        rig.link.stop(2)
