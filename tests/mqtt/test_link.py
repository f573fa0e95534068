"""The link on a real broker: its frames and requests, what a broker refuses,
and addresses that can never work.
"""

from __future__ import annotations

import json
import logging
import socket
import ssl
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from paho.mqtt.client import MQTTMessage
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from support.link_rig import BASE, Rig, code, numbers, offer_for
from support.mqtt_rig import Broker, Subscriber
from support.patience import patience, wait_until
from tacshade_edge.errors import ConfigError
from tacshade_edge.mqtt.client import broker_at
from tacshade_edge.mqtt.link import BadRequest, MqttLink, read_request
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import HeightMap, ObjectCloud, Reconstruction
from tacshade_edge.wire import binary, messages, requests
from tacshade_edge.wire.requests import Request


def reconstruction(seq: int) -> Reconstruction:
    rows, cols = np.mgrid[0:120, 0:160]
    height = np.where(np.hypot(rows - 60, cols - 80) < 55, 0.01 * rows, np.nan).astype(np.float32)
    cloud = ObjectCloud(np.arange(30, dtype=np.float32).reshape(10, 3), np.full(10, 1, np.uint16))
    grid = HeightMap(height, height > 1, 0.0, 0.0, 4.0)
    return Reconstruction(seq, 10, 20, "fast", True, None, True, False, None, grid, cloud)


def unheard(rig: Rig, topic: str) -> None:
    """Offer until the broker says that nobody listens, which holds for a second:
    a slow machine may miss that.
    """

    def nobody() -> bool:
        rig.link.offer(topic, b"", 0)
        return not rig.link.has_listener(topic)

    wait_until(nobody, 3, f"nobody listens to {topic}")


@pytest.mark.broker
class TestUp:
    def test_published_bytes_arrive_as_they_were_and_decode(
        self, rig: Rig, subscriber: Subscriber
    ) -> None:
        result = reconstruction(41)
        height, cloud = (
            encode(result, calibration_crc32=3)
            for encode in (binary.encode_height, binary.encode_cloud)
        )
        rig.link.offer("height", height, 41)
        rig.link.offer("cloud", cloud, 41)
        assert subscriber.wait_for(f"{BASE}/height") == [height]
        assert subscriber.wait_for(f"{BASE}/cloud") == [cloud]
        decoded = binary.decode(height)
        assert isinstance(decoded, binary.HeightMessage)
        np.testing.assert_allclose(decoded.height_mm, result.height.height_mm, atol=0.0006)
        wait_until(lambda: rig.outcomes["cloud"], 3, "outcome")
        assert rig.outcomes["height"] == rig.outcomes["cloud"] == [(41, "published")]
        assert not subscriber.messages[-1].retain

    def test_late_subscriber_finds_the_newest_retained_values(
        self, rig: Rig, broker: Broker
    ) -> None:
        for text in ("opening", "capturing"):
            status = messages.encode_status("online", Reason(ReasonCode.STARTING, text))
            rig.link.set_retained("status/camera", status)
        rig.link.set_retained("health", b'{"captured":1}', qos=0)
        rig.link.set_retained("state", b"degraded")
        with Subscriber(broker.port, f"{BASE}/#") as late:
            for topic, newest in (("state", b"degraded"), ("health", b'{"captured":1}')):
                wait_until(lambda t=topic, n=newest: late.of(f"{BASE}/{t}")[-1:] == [n], 3, topic)
            newest_status = late.wait_for(f"{BASE}/status/camera")[-1]
            assert json.loads(newest_status) == {
                "state": "online",
                "reason": "capturing",
                "reason_code": "starting",
            }

    def test_what_somebody_deletes_is_published_again(self, rig: Rig, broker: Broker) -> None:
        own = {"state": b"online", "info": b'{"a":1}', "status/camera": b'{"state":"away"}'}
        for topic, payload in own.items():
            rig.link.set_retained(topic, payload)
        with Subscriber(broker.port, f"{BASE}/#") as other:
            for topic, payload in own.items():
                wait_until(lambda t=topic: other.of(f"{BASE}/{t}"), 3, topic)
                before = len(other.of(f"{BASE}/{topic}"))
                other.publish(f"{BASE}/{topic}", b"", retain=True)
                wait_until(
                    lambda t=topic, p=payload, n=before: other.of(f"{BASE}/{t}")[n:] == [b"", p],
                    5,
                    topic,
                )
            other.publish(f"{BASE}/status/of-another", b"", retain=True)
            other.publish(f"{BASE}/state", b"", retain=True)
            other.wait_for(f"{BASE}/state", 4)
            assert other.of(f"{BASE}/status/of-another") == [b""]
        with Subscriber(broker.port, f"{BASE}/#") as late:
            for topic, payload in own.items():
                assert late.wait_for(f"{BASE}/{topic}") == [payload]
        assert rig.link.counters()["bad_requests"] == 0

    def test_a_stream_is_wanted_while_someone_listens(self, rig: Rig, broker: Broker) -> None:
        assert rig.link.has_listener("height")  # nothing is known yet
        unheard(rig, "height")
        assert rig.link.has_listener("cloud")
        with Subscriber(broker.port, f"{BASE}/height") as subscriber:
            wait_until(lambda: rig.link.has_listener("height"), 3, "time to ask again")
            rig.link.offer("height", b"1", 1)
            subscriber.wait_for(f"{BASE}/height")
            wait_until(lambda: rig.link.has_listener("height"), 3, "heard")

    def test_stop_says_stopped_after_the_last_frame(
        self, broker: Broker, subscriber: Subscriber
    ) -> None:
        rig = Rig(broker.port).connect()
        for seq in range(5):
            rig.link.offer("height", seq.to_bytes(4, "big") + bytes(200_000), seq)
        rig.link.stop(patience(10))  # a megabyte on a machine with other work
        rig.link.stop(10)  # again is nothing
        assert subscriber.wait_for(f"{BASE}/state", 2)[-1] == b"stopped"
        assert numbers(subscriber)[-1] == 4
        topics = [m.topic for m in subscriber.messages]
        assert topics.index(f"{BASE}/height") < len(topics) - 1
        assert topics[-1] == f"{BASE}/state"
        rig.link.offer("height", b"late", 5)
        assert sorted(s for s, _ in rig.outcomes["height"]) == list(range(6))
        assert rig.outcomes["height"][-1] == (5, "failed")
        assert not rig.link.connected
        assert rig.link.counters()["losses"] == 0

    def test_killed_process_leaves_offline(self, broker: Broker, subscriber: Subscriber) -> None:
        code = (
            "import sys, threading; from tacshade_edge.mqtt.client import broker_at\n"
            "from tacshade_edge.mqtt.link import MqttLink\n"
            "link = MqttLink(broker_at('127.0.0.1', int(sys.argv[1])), base_topic=sys.argv[2], "
            "client_id='child', on_request=print, on_outcome=print)\n"
            "link.start(); threading.Event().wait()"
        )
        child = subprocess.Popen([sys.executable, "-c", code, str(broker.port), BASE])
        try:
            assert subscriber.wait_for(f"{BASE}/state", timeout_s=15) == [b"online"]
        finally:
            child.kill()
            child.wait(patience(10))
        assert subscriber.wait_for(f"{BASE}/state", 2) == [b"online", b"offline"]
        with Subscriber(broker.port, f"{BASE}/state") as late:
            assert late.wait_for(f"{BASE}/state") == [b"offline"]
        with Subscriber(broker.port, f"{BASE}/state", v5=True) as late:
            late.wait_for(f"{BASE}/state")
            assert late.messages[0].properties.ContentType == "text/plain"

    def test_payloads_and_passwords_are_not_logged(
        self, broker: Broker, caplog: pytest.LogCaptureFixture
    ) -> None:
        caplog.set_level(logging.DEBUG)
        rig = Rig(broker.port, username="u", password="pa55word").connect()
        rig.link.offer("contact", b"pay1oad", 0)
        rig.link.stop(2)
        assert "connected" in caplog.text
        assert "pa55word" not in caplog.text
        assert "pay1oad" not in caplog.text


@pytest.mark.broker
class TestRefused:
    def test_wrong_password_is_a_state_with_a_reason(self, tmp_path: Path) -> None:
        with Broker(tmp_path, users={"sensor": "right"}) as broker:
            wrong = Rig(broker.port, username="sensor", password="wrong")
            wrong.link.start()
            wait_until(lambda: code(wrong) is ReasonCode.REFUSED, 5, "the reason")
            assert (
                str(wrong.link.reason)
                == f"127.0.0.1:{broker.port}: rejects the connection: Not authorized"
            )
            assert not wrong.link.connected
            wrong.link.stop(2)
            Rig(broker.port, username="sensor", password="right").connect().link.stop(2)

    def test_what_the_access_rules_deny_is_reported_once_and_never_counts_as_published(
        self, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        """The rules as shipped, and a sensor_id that is not the user's name."""
        caplog.set_level(logging.INFO)
        rules = tmp_path / "acl"
        rules.touch(0o600)
        rules.write_text((Path(__file__).parents[2] / "systemd/mosquitto-tacshade.acl").read_text())
        with Broker(tmp_path, users={"hand": "right"}, more=(f"acl_file {rules}",)) as broker:
            rig = Rig(broker.port, username="hand", password="right").connect()
            rig.link.set_retained("status/camera", b"{}")
            offered = offer_for(rig, 2.0)
            offered += offer_for(rig, 0.2, first=offered)
            rig.link.reply(Request("status"), b"{}")
            wait_until(lambda: rig.counts("height").total() == offered, 5, "all are settled")
            counts = rig.counts("height")
            assert counts["published"] == 0
            assert counts["refused"] >= offered - 5
            counters = rig.link.counters()
            assert counters["refused"] >= counts["refused"] + 2  # state, status/camera
            assert counters["published"] == 0
            wait_until(
                lambda: rig.link.counters()["refused"] > counters["refused"],
                5,
                "the reply is refused too",
            )
            rig.link.stop(2)
        reported = [record for record in caplog.records if record.levelno >= logging.WARNING]
        assert [record.getMessage() for record in reported] == [
            (
                f"127.0.0.1:{broker.port}: rejects {BASE}/state: Not authorized, expected access "
                f"rules (ACL) that allow this user to publish to {BASE}/#; further rejections are "
                "not logged"
            )
        ]

    def test_something_else_on_the_port(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            rig = Rig(server.getsockname()[1])
            rig.link.start()
            peer, _ = server.accept()
            peer.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
            peer.close()
            wait_until(lambda: code(rig) is ReasonCode.NO_ANSWER, 5, "the reason")
            rig.link.stop(2)
        assert not rig.link.connected

    # paho leaves the socket of a failed handshake to the garbage collector
    @pytest.mark.filterwarnings(
        "ignore:Exception ignored in. <ssl.SSLSocket:pytest.PytestUnraisableExceptionWarning"
    )
    def test_tls(self, tmp_path: Path) -> None:
        with Broker(tmp_path, tls=True) as broker:
            rig = Rig(broker.port, tls_ca=str(broker.ca)).connect()
            rig.link.offer("height", b"x", 0)
            wait_until(lambda: rig.outcomes["height"] == [(0, "published")], 3, "published")
            rig.link.stop(2)
            (tmp_path / "other").mkdir()
            other = Broker(tmp_path / "other", tls=True)
            stranger = Rig(broker.port, tls_ca=str(other.ca))
            stranger.link.start()
            wait_until(
                lambda: "certificate verify failed" in str(stranger.link.reason), 5, "the reason"
            )
            stranger.link.stop(2)


def test_authority_file_that_is_none_is_a_configuration_error(tmp_path: Path) -> None:
    (tmp_path / "not.pem").write_text("hello")
    for name in ("not.pem", "absent.pem"):
        with pytest.raises(ConfigError, match=f"{name}.*expected a PEM file") as caught:
            Rig(1883, tls_ca=str(tmp_path / name))
        assert isinstance(caught.value.__cause__, OSError | ssl.SSLError)


def request(verb: str, payload: bytes, asked: str | None = None) -> MQTTMessage:
    message = MQTTMessage(0, f"{BASE}/req/{verb}".encode())
    message.payload, message.properties = payload, Properties(PacketTypes.PUBLISH)
    if asked is not None:
        message.properties.ResponseTopic = asked
    return message


@pytest.mark.parametrize(
    "asked",
    [
        *(
            f"{BASE}/{topic}"
            for topic in ("state", "map/final", "req/status", "res", "res/", "resx/a", "RES/a")
        ),
        "me/answers",
        "tacshade/other/res/a",
        "/",
        " ",
        f"/{BASE}/res/a",
        f"{BASE}/res/a\nb",
        f"{BASE}/res/+",
    ],
)
def test_a_reply_goes_below_res_whatever_topic_is_asked_for(asked: str) -> None:
    """Who may ask may not speak as the hand, nor make it speak elsewhere or on a topic
    that ends the connection.
    """
    for payload, topic in ((b"{}", None), (b"garbage", "res/status")):
        read = read_request(BASE, f"{BASE}/req/status", request("status", payload, asked))
        assert (read.response_topic if isinstance(read, Request) else read.topic) == topic
    bad = read_request(BASE, f"{BASE}/req/sta\ntus", request("sta\ntus", b"{}"))
    assert isinstance(bad, BadRequest)
    assert bad.topic is None


@pytest.mark.parametrize("topic", ["", "/a", "a/", "a/+/b", "a/#", "a\0"])
def test_topic_that_cannot_be_published_is_a_configuration_error(topic: str) -> None:
    with pytest.raises(ConfigError, match="expected levels"):
        MqttLink(
            broker_at("h", 1), base_topic=topic, client_id="c", on_request=print, on_outcome=print
        )


@pytest.mark.parametrize("host", ["", "a..b", "x" * 70])
def test_host_that_cannot_be_one_is_a_configuration_error(host: str) -> None:
    with pytest.raises(ConfigError, match="expected a host name"):
        MqttLink(
            broker_at(host, 1), base_topic="t", client_id="c", on_request=print, on_outcome=print
        )


@pytest.mark.broker
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

    def test_garbage_is_counted_and_answered(self, rig: Rig, subscriber: Subscriber) -> None:
        for verb, payload in (
            ("status", b"\xff\x00"),
            ("profile", b'{"transaction": 5}'),
            ("explode", b"{}"),
        ):
            subscriber.publish(f"{BASE}/req/{verb}", payload)
            answer = json.loads(subscriber.wait_for(f"{BASE}/res/{verb}")[0])
            assert answer["ok"] is False
            assert "expected" in answer["error"]
        assert json.loads(subscriber.of(f"{BASE}/res/profile")[0])["transaction"] == 5
        subscriber.publish(
            f"{BASE}/req/status", bytes(1_000_000)
        )  # the broker never sends us that much
        subscriber.publish(f"{BASE}/req/status", b"")
        assert rig.requests.get(timeout=patience(5)) == Request("status")
        assert rig.requests.empty()
        assert (
            rig.link.counters() | {"replies": 3, "bad_requests": 3, "requests": 1}
            == rig.link.counters()
        )
        assert rig.link.connected

    def test_retained_request_is_not_executed_on_connecting(
        self, broker: Broker, subscriber: Subscriber
    ) -> None:
        subscriber.publish(f"{BASE}/req/reference", b"{}", retain=True)
        subscriber.wait_for(f"{BASE}/req/reference")
        rig = Rig(broker.port).connect()
        subscriber.publish(f"{BASE}/req/status", b"{}")
        assert rig.requests.get(timeout=patience(5)).verb == "status"
        assert rig.requests.empty()
        rig.link.stop(2)

    def test_flood_of_requests_to_a_stalled_broker_holds_few_replies(
        self, rig: Rig, broker: Broker
    ) -> None:
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
