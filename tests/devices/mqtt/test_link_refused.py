"""What a broker refuses, and addresses that can never work."""

from __future__ import annotations

import logging
import socket
import ssl
from pathlib import Path

import pytest
from support.link_rig import BASE, Rig, broker_test, code, needs_mosquitto, offer_for

from tacshade_edge.devices.mqtt.link import MqttLink
from tacshade_edge.errors import ConfigError
from tacshade_edge.protocol.requests import Request
from tacshade_edge.reasons import ReasonCode
from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.patience import wait_until


@broker_test
@needs_mosquitto
class TestRefused:
    def test_wrong_password_is_a_state_with_a_reason(self, tmp_path: Path) -> None:
        with Broker(tmp_path, users={"sensor": "right"}) as broker:
            wrong = Rig(broker.port, username="sensor", password="wrong")
            wrong.link.start()
            wait_until(lambda: code(wrong) is ReasonCode.REFUSED, 5, "the reason")
            assert str(wrong.link.reason) == f"127.0.0.1:{broker.port}: rejects the connection: Not authorized"
            assert not wrong.link.connected
            wrong.link.stop(2)
            Rig(broker.port, username="sensor", password="right").connect().link.stop(2)

    def test_what_the_access_rules_deny_is_told_once_and_never_counts_as_published(
        self, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        """The rules as shipped, and a sensor_id that is not the user's name."""
        caplog.set_level(logging.INFO)
        rules = tmp_path / "acl"
        rules.touch(0o600)
        rules.write_text((Path(__file__).parents[3] / "systemd/mosquitto-tacshade.acl").read_text())
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
            wait_until(lambda: rig.link.counters()["refused"] > counters["refused"], 5, "the reply is refused too")
            rig.link.stop(2)
        told = [record for record in caplog.records if record.levelno >= logging.WARNING]
        assert [record.getMessage() for record in told] == [
            f"127.0.0.1:{broker.port}: rejects {BASE}/state: Not authorized, expected access rules (ACL) that allow "
            f"this user to publish to {BASE}/#; further rejections are not logged"
        ]

    def test_a_stream_that_alone_is_denied_is_refused_and_the_others_go_out(self, tmp_path: Path) -> None:
        rules = tmp_path / "acl"
        rules.touch(0o600)
        rules.write_text(f"topic readwrite {BASE}/#\ntopic deny {BASE}/cloud\n")
        with Broker(tmp_path, more=(f"acl_file {rules}",)) as broker, Subscriber(broker.port, f"{BASE}/#") as seen:
            rig = Rig(broker.port).connect()
            rig.link.offer("cloud", b"0", 0)
            wait_until(lambda: rig.outcomes["cloud"] == [(0, "refused")], 5, "refused")
            for seq in range(1, 5):
                rig.link.offer("height", b"%d" % seq, seq)
                rig.link.offer("cloud", b"%d" % seq, seq)
                wait_until(lambda seq=seq: rig.counts("cloud").total() == seq + 1, 5, "settled")
            seen.wait_for(f"{BASE}/height", 4)
            assert rig.counts("cloud") == {"refused": 5}
            assert rig.counts("height") == {"published": 4}
            rig.link.stop(2)

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
    @pytest.mark.filterwarnings("ignore:Exception ignored in. <ssl.SSLSocket:pytest.PytestUnraisableExceptionWarning")
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
            wait_until(lambda: "certificate verify failed" in str(stranger.link.reason), 5, "the reason")
            stranger.link.stop(2)


def test_authority_file_that_is_none_is_a_configuration_error(tmp_path: Path) -> None:
    (tmp_path / "not.pem").write_text("hello")
    for name in ("not.pem", "absent.pem"):
        with pytest.raises(ConfigError, match=f"{name}.*expected a PEM file") as caught:
            Rig(1883, tls_ca=str(tmp_path / name))
        assert isinstance(caught.value.__cause__, OSError | ssl.SSLError)


@pytest.mark.parametrize("topic", ["", "/a", "a/", "a/+/b", "a/#", "a\0"])
def test_topic_that_cannot_be_published_is_a_configuration_error(topic: str) -> None:
    with pytest.raises(ConfigError, match="expected levels"):
        MqttLink(host="h", port=1, base_topic=topic, client_id="c", on_request=print, on_outcome=print)


@pytest.mark.parametrize("host", ["", "a..b", "x" * 70])
def test_host_that_cannot_be_one_is_a_configuration_error(host: str) -> None:
    with pytest.raises(ConfigError, match="expected a host name"):
        MqttLink(host=host, port=1, base_topic="t", client_id="c", on_request=print, on_outcome=print)
