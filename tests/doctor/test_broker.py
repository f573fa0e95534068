"""A real mosquitto, and what else may stand at its address."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tacshade_edge.doctor.broker import DaemonState, check_broker, judge_daemon, judge_round_trip
from tacshade_edge.doctor.finding import Finding, ok
from tacshade_edge.doctor.machine import Process
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber, free_port
from tools.testbed.patience import wait_until

BASE = "tacshade/left"
broker_test = pytest.mark.broker
needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")


def ask(port: int, **options: Any) -> tuple[dict[str, Finding], DaemonState]:
    asked: Any = {"host": "127.0.0.1", "port": port, "username": None, "password": None, "tls_ca": None} | options
    findings, daemon = check_broker(asked, "left")
    assert all(bool(finding.fix) == (finding.state != "ok") for finding in findings)
    return {finding.check: finding for finding in findings}, daemon


def trouble(port: int, **options: Any) -> Finding:
    """The one fault of a broker that cannot be used."""
    findings, daemon = ask(port, **options)
    assert daemon == DaemonState()
    assert [finding.state for finding in findings.values()] == ["fault"]
    return findings["broker"]


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.socket() as made:
        made.bind(("127.0.0.1", 0))
        made.listen()
        yield made


def test_nothing_listens() -> None:
    port = free_port()
    finding = trouble(port)
    assert finding.found == f"127.0.0.1:{port}: connection refused: nothing is listening"
    assert "sudo systemctl enable --now mosquitto" in finding.fix
    assert "(mosquitto: `listener`)" in trouble(port, host="127.0.0.2").fix, "another machine's broker is started there"


def test_a_name_without_an_address() -> None:
    finding = trouble(1883, host="no-such-broker.invalid")
    assert finding.found.startswith("no-such-broker.invalid: the name does not resolve")
    assert finding.fix.endswith("getent hosts no-such-broker.invalid")


@broker_test  # for its seconds of waiting
def test_a_port_that_says_nothing(listener: socket.socket) -> None:
    finding = trouble(listener.getsockname()[1])
    assert finding.found.endswith("accepts connections but does not answer, so it is not an MQTT broker")


@broker_test
def test_a_port_that_says_nothing_where_tls_is_expected(listener: socket.socket, tmp_path: Path) -> None:
    with Broker(tmp_path, tls=True) as other:
        finding = trouble(listener.getsockname()[1], tls_ca=str(other.ca))
    assert "no answer within" in finding.found
    assert "Is mqtt.port the broker's TLS port?" in finding.fix


@broker_test
@needs_mosquitto
def test_a_good_broker_and_nobody_on_it(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Subscriber(broker.port, f"{BASE}/#") as seen:
        findings, daemon = ask(broker.port)
        assert findings["broker"].state == "ok"
        assert findings["broker round trip"].found.startswith("a 38 KB message made the round trip in ")
        assert daemon == DaemonState()
        wait_until(lambda: len(seen.of(f"{BASE}/doctor")) >= 6, 5, "the messages that it sent to itself")
    assert {message.topic for message in seen.messages} == {f"{BASE}/doctor"}, "no last will, no state"
    with Broker(tmp_path) as broker, Subscriber(broker.port, f"{BASE}/#") as seen:
        ask(broker.port)
        assert not any(message.retain for message in seen.messages)


@broker_test
@needs_mosquitto
def test_a_daemon_on_it(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Subscriber(broker.port, f"{BASE}/#") as other:
        for name, payload in (
            ("state", b"degraded"),
            ("health", json.dumps({"delivered_fps": 12.5}).encode()),
            ("status/camera", json.dumps({"state": "away", "reason": "no such device"}).encode()),
        ):
            other.publish(f"{BASE}/{name}", payload, retain=True)
            other.wait_for(f"{BASE}/{name}")
        assert ask(broker.port)[1] == DaemonState("degraded", "no such device", 12.5)
        other.publish(f"{BASE}/health", b"\xff{", retain=True)
        other.wait_for(f"{BASE}/health", 2)
        assert ask(broker.port)[1] == DaemonState("degraded", "no such device", 0.0)
        for name, process in (("instance", 7), ("status/rival", 8)):
            other.publish(f"{BASE}/{name}", json.dumps({"host": "bench", "process": process}).encode(), retain=True)
            other.wait_for(f"{BASE}/{name}")
        daemon = ask(broker.port)[1]
        assert (daemon.place, daemon.rival) == ("on bench, process 7", "on bench, process 8")


@broker_test
@needs_mosquitto
def test_users_and_access_rules(tmp_path: Path) -> None:
    broker = Broker(tmp_path, users={"hand": "right", "guest": "right"})
    rules = tmp_path / "acl"
    rules.touch(0o600)
    rules.write_text(f"user hand\ntopic readwrite tacshade/#\nuser guest\ntopic read {BASE}/#\n")
    with (tmp_path / "mosquitto.conf").open("a") as config:
        config.write(f"acl_file {rules}\n")
    with broker:
        assert ask(broker.port, username="hand", password="right")[0]["broker round trip"].state == "ok"
        wrong = trouble(broker.port, username="hand", password="wrong")
        assert "rejects the user hand or the password" in wrong.found
        assert wrong.fix.endswith("/etc/mosquitto/tacshade.passwd hand")
        nobody = trouble(broker.port)
        assert "without a user name" in nobody.found
        assert "mqtt.username" in nobody.fix
        denied = ask(broker.port, username="guest", password="right")[0]["broker round trip"]
        assert denied.state == "fault"
        assert denied.found.startswith(f"the broker does not let this user publish to topics under {BASE}/")
        assert "user guest, then topic readwrite" in denied.fix


@broker_test
@needs_mosquitto
def test_the_rules_as_shipped_and_another_name_than_the_sensors(tmp_path: Path) -> None:
    rules = tmp_path / "acl"
    rules.touch(0o600)
    rules.write_text((Path(__file__).parents[2] / "systemd/mosquitto-tacshade.acl").read_text())
    with Broker(tmp_path, users={"hand": "right"}, more=(f"acl_file {rules}",)) as broker:
        denied = ask(broker.port, username="hand", password="right")[0]["broker round trip"]
    assert denied.state == "fault"
    assert denied.found == f"the broker does not let this user publish to topics under {BASE}/ (Not authorized)"


@broker_test
@needs_mosquitto
def test_a_broker_that_takes_small_packets_only(tmp_path: Path) -> None:
    with Broker(tmp_path, more=("max_packet_size 20000",)) as broker:
        small = ask(broker.port)[0]["broker round trip"]
    assert small.state == "warning"
    assert small.found.startswith(
        "the broker accepts packets of at most 20000 bytes; the daemon skips larger height maps"
    )


@broker_test
@needs_mosquitto
def test_a_broker_that_must_not_be_read(tmp_path: Path) -> None:
    broker = Broker(tmp_path)
    rules = tmp_path / "acl"
    rules.touch(0o600)
    rules.write_text("topic write tacshade/#\n")
    with (tmp_path / "mosquitto.conf").open("a") as config:
        config.write(f"acl_file {rules}\n")
    with broker:
        denied = ask(broker.port)[0]["broker round trip"]
    assert denied.state == "fault"
    assert "topic readwrite" in denied.fix


@broker_test
@needs_mosquitto
def test_tls(tmp_path: Path) -> None:
    for name in ("ours", "theirs"):
        (tmp_path / name).mkdir()
    other = Broker(tmp_path / "theirs", tls=True)
    with Broker(tmp_path / "ours", tls=True) as broker:
        good, _ = ask(broker.port, tls_ca=str(broker.ca))
        assert "accepted the connection over TLS" in good["broker"].found
        wrong = trouble(broker.port, tls_ca=str(other.ca))
        assert "its certificate failed verification: self-signed certificate" in wrong.found
        assert wrong.fix.startswith("set mqtt.ca_file")
        assert good["broker round trip"].state != "fault"
        named = trouble(broker.port, tls_ca=str(broker.ca), host="127.1")
        assert "is not valid for '127.1'" in named.found
        assert "for 127.1 (subjectAltName)" in named.fix
        plain = trouble(broker.port)
        assert plain.found.endswith("accepts connections but hangs up, so it is not an MQTT broker")
        assert "If the port is a TLS port (8883), set mqtt.ca_file" in plain.fix
    with Broker(tmp_path / "theirs") as broker:
        finding = trouble(broker.port, tls_ca=str(tmp_path / "ours/cert.pem"))
        assert "TLS" in finding.found or "no answer" in finding.found or "reset" in finding.found
        assert finding.fix


@broker_test
@needs_mosquitto
def test_a_broker_that_hangs(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker:
        broker.stall()
        assert "does not answer" in trouble(broker.port).found


@pytest.mark.parametrize(
    ("daemon", "running", "state", "found"),
    [
        (DaemonState(), False, "ok", "not running"),
        (DaemonState("stopped"), False, "ok", "not running"),
        (DaemonState("online", fps=29.9), True, "ok", "process 5 (tacshade-edge run): online, 29.9 frames/s"),
        (DaemonState("degraded", "no device", 0.0), True, "warning", "degraded, 0.0 frames/s, no device"),
        (DaemonState("online"), False, "warning", "no daemon is running here, yet left is online on this broker"),
        (
            DaemonState("online", place="on a", rival="on b"),
            True,
            "warning",
            "one is running on a, and the other is waiting on b",
        ),
        (DaemonState("offline"), True, "warning", "left is not online at the broker"),
    ],
)
def test_the_daemon(daemon: DaemonState, running: bool, state: str, found: str) -> None:
    finding = judge_daemon(daemon, Process(5, ("tacshade-edge", "run")) if running else None, "left")
    assert finding.state == state
    assert found in finding.found
    assert bool(finding.fix) == (state != "ok")


def test_a_slow_round_trip() -> None:
    assert judge_round_trip(1.2) == ok("broker round trip", "a 38 KB message made the round trip in 1.2 ms")
    slow = judge_round_trip(41)
    assert slow.state == "warning"
    assert slow.fix.startswith("add `set_tcp_nodelay true`")
