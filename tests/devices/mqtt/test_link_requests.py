"""What is asked of the link, and what it answers."""

from __future__ import annotations

import json

import pytest
from paho.mqtt.client import MQTTMessage
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from support.link_rig import BASE, Rig, broker_test, needs_mosquitto

from tacshade_edge.protocol import requests
from tacshade_edge.protocol.requests import Request
from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.patience import patience, wait_until


@broker_test
@needs_mosquitto
class TestRequests:
    def test_request_and_reply_for_any_client(self, rig: Rig, subscriber: Subscriber) -> None:
        subscriber.publish(f"{BASE}/req/profile", b'{"profile": "fast", "transaction": "t1"}')
        request = rig.requests.get(timeout=patience(5))
        assert request == Request("profile", "t1", "fast")
        rig.link.reply(request, requests.encode_reply(request, {"profile": "fast"}))
        assert json.loads(subscriber.wait_for(f"{BASE}/res/profile")[0])["transaction"] == "t1"

    def test_mqtt5_client_is_answered_where_it_asked(self, rig: Rig, broker: Broker) -> None:
        properties = Properties(PacketTypes.PUBLISH)
        properties.ResponseTopic = asked = f"{BASE}/res/of/me"
        properties.CorrelationData = b"\x00\x01"
        with Subscriber(broker.port, "#", v5=True) as client:
            client.publish(f"{BASE}/req/status", b"{}", properties=properties)
            request = rig.requests.get(timeout=patience(5))
            rig.link.reply(request, b"fine")
            client.publish(f"{BASE}/req/status", b"garbage", properties=properties)
            assert client.wait_for(asked, 2)[0] == b"fine"
            answers = [m for m in client.messages if m.topic == asked]
            assert [m.properties.CorrelationData for m in answers] == [b"\x00\x01"] * 2
            assert json.loads(answers[1].payload)["ok"] is False
            assert client.of(f"{BASE}/res/status") == []

    @pytest.mark.parametrize(
        "asked",
        [
            *(f"{BASE}/{topic}" for topic in ("state", "map/final", "req/status", "res", "res/", "resx/a", "RES/a")),
            *("me/answers", "tacshade/other/res/a", "/", " ", f"/{BASE}/res/a"),
        ],
    )
    def test_a_reply_goes_below_res_whatever_topic_is_asked_for(self, rig: Rig, broker: Broker, asked: str) -> None:
        """Who may ask may not speak as the hand, nor make it speak elsewhere."""
        properties = Properties(PacketTypes.PUBLISH)
        properties.ResponseTopic = asked
        with Subscriber(broker.port, "#", v5=True) as client:
            before = len(client.messages)
            for payload in (b"{}", b"garbage"):
                client.publish(f"{BASE}/req/status", payload, properties=properties)
            rig.link.reply(rig.requests.get(timeout=patience(5)), b"fine")
            client.wait_for(f"{BASE}/res/status", 2)
            topics = {m.topic for m in client.messages[before:] if not m.retain}
            own = {f"{BASE}/state", f"{BASE}/instance"}  # of its connecting, still on their way
            assert topics - own == {f"{BASE}/req/status", f"{BASE}/res/status"}
            assert set(client.of(f"{BASE}/state")) == {b"online"}

    def test_a_reply_never_costs_the_connection(self, rig: Rig, subscriber: Subscriber) -> None:
        """Mosquitto ends one that publishes on a topic with control characters; others may let such a request pass."""
        properties = Properties(PacketTypes.PUBLISH)
        properties.ResponseTopic = f"{BASE}/res/a\nb"
        for verb, asked in (("status", properties), ("sta\ntus", None), ("explode", properties)):
            message = MQTTMessage(0, f"{BASE}/req/{verb}".encode())
            message.payload, message.properties = b"garbage", asked
            rig.link._on_message(message.topic, message)
        subscriber.wait_for(f"{BASE}/res/status")
        subscriber.wait_for(f"{BASE}/res/explode")
        assert rig.link.counters() | {"replies": 2, "bad_requests": 3, "losses": 0} == rig.link.counters()

    def test_garbage_is_counted_and_answered(self, rig: Rig, subscriber: Subscriber) -> None:
        for verb, payload in (("status", b"\xff\x00"), ("profile", b'{"transaction": 5}'), ("explode", b"{}")):
            subscriber.publish(f"{BASE}/req/{verb}", payload)
            answer = json.loads(subscriber.wait_for(f"{BASE}/res/{verb}")[0])
            assert answer["ok"] is False
            assert "expected" in answer["error"]
        assert json.loads(subscriber.of(f"{BASE}/res/profile")[0])["transaction"] == 5
        subscriber.publish(f"{BASE}/req/status", bytes(1_000_000))  # the broker never sends us that much
        subscriber.publish(f"{BASE}/req/status", b"")
        assert rig.requests.get(timeout=patience(5)) == Request("status")
        assert rig.requests.empty()
        assert rig.link.counters() | {"replies": 3, "bad_requests": 3, "requests": 1} == rig.link.counters()
        assert rig.link.connected

    def test_retained_request_is_not_executed_on_connecting(self, broker: Broker, subscriber: Subscriber) -> None:
        subscriber.publish(f"{BASE}/req/reference", b"{}", retain=True)
        subscriber.wait_for(f"{BASE}/req/reference")
        rig = Rig(broker.port).connect()
        subscriber.publish(f"{BASE}/req/status", b"{}")
        assert rig.requests.get(timeout=patience(5)).verb == "status"
        assert rig.requests.empty()
        rig.link.stop(2)

    def test_flood_of_requests_to_a_stalled_broker_holds_few_replies(self, rig: Rig, broker: Broker) -> None:
        broker.stall()
        for _ in range(1_000):
            rig.link.reply(Request("status"), bytes(1_000))
        assert rig.link.counters()["replies"] == 16
        assert rig.link.counters()["replies_dropped"] == 984

    def test_events_arrive_each_once_and_are_not_retained(
        self, rig: Rig, broker: Broker, subscriber: Subscriber
    ) -> None:
        for k in range(3):
            rig.link.publish_event("event/slip", b"%d" % k)
        assert subscriber.wait_for(f"{BASE}/event/slip", 3) == [b"0", b"1", b"2"]
        with Subscriber(broker.port) as late:
            rig.link.publish_event("event/slip", b"3")
            assert late.wait_for(f"{BASE}/event/slip") == [b"3"]
        assert rig.link.counters() | {"events": 4, "events_dropped": 0} == rig.link.counters()

    def test_events_of_a_broker_that_is_away_are_counted(self, rig: Rig, broker: Broker) -> None:
        broker.kill()
        wait_until(lambda: not rig.link.connected, 5, "the loss")
        rig.link.publish_event("event/slip", b"lost")
        assert rig.link.counters()["events_dropped"] == 1
        broker.start()
