"""The MQTT link against a real mosquitto: up, away, restarted, stalled, killed, refused."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import time

import numpy as np
import pytest
from support.link_rig import BASE, Rig, broker_test, needs_mosquitto, numbers

from tacshade_edge.protocol import messages, wire
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import HeightMap, ObjectCloud, Reconstruction
from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.patience import patience, wait_until


def reconstruction(seq: int) -> Reconstruction:
    rows, cols = np.mgrid[0:120, 0:160]
    height = np.where(np.hypot(rows - 60, cols - 80) < 55, 0.01 * rows, np.nan).astype(np.float32)
    cloud = ObjectCloud(np.arange(30, dtype=np.float32).reshape(10, 3), np.full(10, 1, np.uint16))
    grid = HeightMap(height, height > 1, 0.0, 0.0, 4.0)
    return Reconstruction(seq, 10, 20, "fast", True, None, True, False, None, grid, cloud)


def unheard(rig: Rig, topic: str) -> None:
    """Offer until the broker says that nobody listens, which holds for a second: a slow machine may miss that."""

    def nobody() -> bool:
        rig.link.offer(topic, b"", 0)
        return not rig.link.has_listener(topic)

    wait_until(nobody, 3, f"nobody listens to {topic}")


@broker_test
@needs_mosquitto
class TestUp:
    def test_published_bytes_arrive_as_they_were_and_decode(self, rig: Rig, subscriber: Subscriber) -> None:
        result = reconstruction(41)
        height, cloud = (encode(result, calibration_crc32=3) for encode in (wire.encode_height, wire.encode_cloud))
        rig.link.offer("height", height, 41)
        rig.link.offer("cloud", cloud, 41)
        assert subscriber.wait_for(f"{BASE}/height") == [height]
        assert subscriber.wait_for(f"{BASE}/cloud") == [cloud]
        decoded = wire.decode(height)
        assert isinstance(decoded, wire.HeightMessage)
        np.testing.assert_allclose(decoded.height_mm, result.height.height_mm, atol=0.0006)
        wait_until(lambda: rig.outcomes["cloud"], 3, "outcome")
        assert rig.outcomes["height"] == rig.outcomes["cloud"] == [(41, "published")]
        assert not subscriber.messages[-1].retain

    def test_late_subscriber_finds_the_newest_retained_values(self, rig: Rig, broker: Broker) -> None:
        for text in ("opening", "capturing"):
            status = messages.encode_status("online", Reason(ReasonCode.STARTING, text))
            rig.link.set_retained("status/camera", status)
        rig.link.set_retained("health", b'{"captured":1}', qos=0)
        rig.link.set_retained("state", b"degraded")
        with Subscriber(broker.port, f"{BASE}/#") as late:
            for topic, newest in (("state", b"degraded"), ("health", b'{"captured":1}')):
                wait_until(lambda t=topic, n=newest: late.of(f"{BASE}/{t}")[-1:] == [n], 3, topic)
            newest_status = late.wait_for(f"{BASE}/status/camera")[-1]
            assert json.loads(newest_status) == {"state": "online", "reason": "capturing", "reason_code": "starting"}

    def test_a_stream_is_wanted_while_someone_listens_and_once_a_second_else(self, rig: Rig, broker: Broker) -> None:
        assert rig.link.has_listener("height")  # nothing is known yet
        unheard(rig, "height")
        assert rig.link.has_listener("cloud")
        wait_until(lambda: rig.link.has_listener("height"), 3, "time to ask again")
        with Subscriber(broker.port, f"{BASE}/height", v5=True) as subscriber:
            began, answers = time.monotonic(), 0
            for seq in range(1, 150):
                rig.link.offer("height", bytes([seq]), seq)
                wait_until(lambda seq=seq: rig.outcomes["height"][-1][0] == seq, 3, "sent")
                answers += rig.link.has_listener("height")
            subscriber.wait_for(f"{BASE}/height", 149)
            assert answers == 149
            qos1 = sum(m.qos == 1 for m in subscriber.messages)
            assert 1 <= qos1 <= time.monotonic() - began + 1
        assert [m.payload[0] for m in subscriber.messages] == list(range(1, 150))
        unheard(rig, "cloud")  # each stream has its own listeners

    def test_a_broker_that_comes_back_may_have_listeners(self, rig: Rig, broker: Broker) -> None:
        unheard(rig, "height")
        broker.kill()
        wait_until(lambda: rig.link.has_listener("height"), 3, "wanted")
        broker.start()

    def test_stop_says_stopped_after_the_last_frame(self, broker: Broker, subscriber: Subscriber) -> None:
        rig = Rig(broker.port).connect()
        for seq in range(5):
            rig.link.offer("height", seq.to_bytes(4, "big") + bytes(200_000), seq)
        rig.link.stop(2)
        rig.link.stop(2)  # again is nothing
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
            "import sys, threading; from tacshade_edge.devices.mqtt.link import MqttLink\n"
            "link = MqttLink(host='127.0.0.1', port=int(sys.argv[1]), base_topic=sys.argv[2], client_id='child',"
            " on_request=print, on_outcome=print)\n"
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

    def test_payloads_and_passwords_are_not_logged(self, broker: Broker, caplog: pytest.LogCaptureFixture) -> None:
        caplog.set_level(logging.DEBUG)
        rig = Rig(broker.port, username="u", password="pa55word").connect()
        rig.link.offer("contact", b"pay1oad", 0)
        rig.link.stop(2)
        assert "connected" in caplog.text
        assert "pa55word" not in caplog.text
        assert "pay1oad" not in caplog.text
