"""No message of a broker ends a client's thread:
daemon, bridges, requests, library and the client's wheel.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest
import tacshade_client as tc

import tacshade_edge as ts
from support.hostile_broker import BAD, BAD_TOPICS, HostileBroker, packet, publish
from support.link_rig import BASE, Rig
from support.patience import patience, wait_until
from support.published_sensor import CRC, bump
from tacshade_edge.bridge.prometheus import SensorMetrics
from tacshade_edge.mqtt import client
from tacshade_edge.mqtt.caller import MqttCaller
from tacshade_edge.mqtt.client import BrokerAddress, broker_at
from tacshade_edge.mqtt.follower import Follower
from tacshade_edge.wire import binary, messages
from tacshade_edge.wire.requests import Request

HEIGHT = binary.encode_height(bump(7, 2.0, 236.0, 328.0, step_px=8), calibration_crc32=CRC)
BELOW_TACSHADE = 4
"""Of the bad topics: passed over, as messages that come after their topic was unsubscribed."""


OUT_OF_ORDER = (
    publish(f"{BASE}/req/status".encode(), b"{}"),
    packet(0x90, b"\0\x63\0\0"),  # SUBACK of what nobody asked
    packet(0x40, b"\0\x63"),  # PUBACK, PUBREC, PUBREL, PUBCOMP of what nobody sent
    packet(0x50, b"\0\x63"),
    packet(0x62, b"\0\x63"),
    packet(0x70, b"\0\x63"),
    packet(0xB0, b"\0\x63\0\0"),  # UNSUBACK
    packet(0xD0, b""),  # PINGRESP without a PINGREQ
)


def address(port: int) -> BrokerAddress:
    return broker_at("127.0.0.1", port)


def test_a_daemon_counts_a_bad_topic_and_takes_a_suback_with_any_number_of_codes() -> None:
    after = publish(f"{BASE}/req/status".encode(), b"{}")
    with HostileBroker(BAD, after, extra_codes=3) as broker:
        rig = Rig(broker.port).connect()
        assert rig.requests.get(timeout=patience(5)) == Request("status")
        assert rig.link.counters()["bad_requests"] == len(BAD_TOPICS)
        assert rig.link.connected
        assert broker.connects == 2  # the guard of the client's id is the first
        rig.link.stop(2)


def test_a_link_has_settled_only_when_the_broker_hears_its_requests() -> None:
    settled = threading.Event()
    with HostileBroker() as broker:
        broker.may_grant.clear()
        rig = Rig(broker.port)

        def wait() -> None:
            rig.link.wait_until_settled(patience(10))
            settled.set()

        threading.Thread(target=wait, daemon=True).start()
        rig.connect()
        assert not settled.wait(0.1)
        broker.may_grant.set()
        assert settled.wait(patience(5))
        rig.link.stop(2)


@pytest.mark.slow
def test_packets_that_end_at_every_byte_are_none_and_the_next_connection_is_heard(
    monkeypatch: pytest.MonkeyPatch, record_property: Callable[[str, object], None]
) -> None:
    monkeypatch.setattr(client, "_RECONNECT_DELAY_S", 0.05)
    after = b"".join(OUT_OF_ORDER)
    cuts = range(1, 5 + 6 + len(after))  # CONNACK, and SUBACK of one topic
    record_property("tried", len(cuts))
    with HostileBroker(after, cuts=cuts) as broker:
        rig = Rig(broker.port).connect()
        wait_until(lambda: broker.connects > len(cuts), 60, "a connection that is not cut")
        heard = rig.requests.get(timeout=patience(10))
        wait_until(lambda: rig.link.connected, 10, "connected")
        while not rig.requests.empty():
            assert rig.requests.get() == heard
        rig.link.stop(2)
    assert heard == Request("status")
    assert rig.link.counters()["bad_requests"] == 0


@pytest.mark.parametrize("packets", [OUT_OF_ORDER, OUT_OF_ORDER[::-1]], ids=["", "reversed"])
def test_packets_out_of_their_order_end_no_connection(
    packets: tuple[bytes, ...], record_property: Callable[[str, object], None]
) -> None:
    record_property("tried", len(packets))
    after = publish(f"{BASE}/req/status".encode(), b'{"transaction": 2}')
    with HostileBroker(after, early=b"".join(packets)) as broker:
        rig = Rig(broker.port).connect()
        heard = {rig.requests.get(timeout=patience(10)).transaction for _ in range(2)}
        assert heard == {None, 2}
        assert rig.link.connected
        rig.link.stop(2)
        assert broker.connects == 2


def test_a_subscription_that_is_denied_is_reported_by_its_topic(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with HostileBroker(denied=1) as broker:
        rig = Rig(broker.port)
        rig.link.watch("status/home_assistant", lambda _: None)
        rig.connect()
        wait_until(lambda: "rejects" in caplog.text, 5, "the denial")
        rig.link.stop(2)
    assert f"rejects {BASE}/req/+: Not authorized" in caplog.text


def test_a_bridge_that_stops_reports_no_loss(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    with HostileBroker() as broker:
        follower = Follower(address(broker.port), lambda *_: None)
        follower.start()
        wait_until(lambda: "connected" in caplog.text, 5, "connected")
        follower.stop()
    assert "lost" not in caplog.text


def test_a_bridge_hears_what_follows() -> None:
    sensors = SensorMetrics([])
    with HostileBroker(BAD, publish(b"tacshade/a/state", b"online"), extra_codes=1) as broker:
        follower = Follower(address(broker.port), sensors.hear)
        follower.follow(sensors.topics)
        follower.start()
        wait_until(lambda: metrics(sensors).get(("a", "online")) == 1, 5, "the state")
        assert metrics(sensors)["unknown_topic",] == len(BAD_TOPICS)
        follower.stop()


def metrics(sensors: SensorMetrics) -> dict[tuple[str, ...], float]:
    return {
        tuple(s.labels.values()): s.value for family in sensors.collect() for s in family.samples
    }


def test_a_caller_hears_what_follows() -> None:
    with HostileBroker(BAD, publish(b"tacshade/a/state", b"online"), extra_codes=1) as broker:
        caller = MqttCaller(address(broker.port), sensor_id="a", verb="status", watched=("state",))
        caller.start()
        assert caller.wait_for(lambda: caller.latest("state") == b"online", patience(5))
        caller.stop()


@pytest.mark.slow
def test_the_library_hears_what_follows() -> None:
    contact = messages.encode_contact(bump(7, 0.0, 236.0, 328.0, step_px=8), fps=60.0)
    info = messages.encode_info(version="0", config_digest="0", profile="fast", calibration=None)
    raw = BAD + publish(b"tacshade/a/info", info) + publish(b"tacshade/a/contact", contact)
    with (
        HostileBroker(raw, publish(b"tacshade/a/state", b"degraded"), extra_codes=1) as broker,
        ts.listen(f"127.0.0.1:{broker.port}", "a") as results,
    ):
        with pytest.raises(ts.DeviceError, match="degraded"):
            next(results)
        assert results.refused == len(BAD_TOPICS) - BELOW_TACSHADE


def test_the_client_counts_it_and_hears_what_follows() -> None:
    empty = binary.HEAD.pack(
        *binary.HEAD.unpack_from(HEIGHT)[:9], 0, 0, *binary.HEAD.unpack_from(HEIGHT)[11:23], 0
    )
    raw = BAD, publish(b"tacshade/a/height", empty), publish(b"tacshade/a/state", b"online")
    with (
        HostileBroker(*raw, extra_codes=1) as broker,
        tc.listen(f"127.0.0.1:{broker.port}", "a", ["state", "height"]) as heard,
    ):
        message = heard.get(patience(5))
        assert message is not None
        assert message.value == "online"
        assert heard.refused == len(BAD_TOPICS) - BELOW_TACSHADE + 1


def test_a_dead_thread_of_the_client_raises_in_get(monkeypatch: pytest.MonkeyPatch) -> None:
    with HostileBroker() as broker, tc.listen(f"127.0.0.1:{broker.port}", "a", ["state"]) as heard:
        monkeypatch.setattr(heard, "_numbers", None)  # a defect of ours: receiving raises
        broker.send(publish(b"tacshade/a/state"))
        with pytest.raises(tc.DeviceError, match="receiving ended"):
            heard.get(patience(5))
