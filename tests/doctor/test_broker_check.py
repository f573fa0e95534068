"""A real mosquitto, and what else may stand at its address."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from support.hostile_broker import HostileBroker
from support.mqtt_rig import Broker, Subscriber, free_port
from support.patience import patience, wait_until
from tacshade_edge.doctor import Finding, ok
from tacshade_edge.doctor.broker_check import (
    DaemonState,
    check_broker,
    judge_daemon,
    judge_round_trip,
)
from tacshade_edge.doctor.machine import Process

BASE = "tacshade/left"


def ask(port: int, **options: Any) -> tuple[dict[str, Finding], DaemonState]:
    asked: Any = {
        "host": "127.0.0.1",
        "port": port,
        "username": None,
        "password": None,
        "tls_ca": None,
    } | options
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
    assert "(mosquitto: `listener`)" in trouble(port, host="127.0.0.2").fix, (
        "another machine's broker is started there"
    )
    assert trouble(1883, host="no-such-broker.invalid").fix.endswith(
        "getent hosts no-such-broker.invalid"
    )


@pytest.mark.slow
def test_a_port_that_says_nothing(listener: socket.socket) -> None:
    finding = trouble(listener.getsockname()[1])
    assert finding.found.endswith(
        "accepts connections but does not answer, so it is not an MQTT broker"
    )


@pytest.mark.broker
def test_a_good_broker_and_nobody_on_it(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Subscriber(broker.port, f"{BASE}/#") as seen:
        findings, daemon = ask(broker.port)
        assert findings["broker"].state == "ok"
        assert findings["broker round trip"].found.startswith(
            "a 38 KB message made the round trip in "
        )
        assert daemon == DaemonState()
        wait_until(
            lambda: len(seen.of(f"{BASE}/doctor")) >= 6, 5, "the messages that it sent to itself"
        )
    assert {(message.topic, message.retain) for message in seen.messages} == {
        (f"{BASE}/doctor", False)
    }


@pytest.mark.broker
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
            other.publish(
                f"{BASE}/{name}",
                json.dumps({"host": "bench", "process": process}).encode(),
                retain=True,
            )
            other.wait_for(f"{BASE}/{name}")
        daemon = ask(broker.port)[1]
        assert (daemon.place, daemon.rival) == ("on bench, process 7", "on bench, process 8")


SHIPPED = (Path(__file__).parents[2] / "systemd/mosquitto-tacshade.acl").read_text()


@pytest.mark.broker
@pytest.mark.parametrize(
    ("rules", "username", "state", "fix"),
    [
        ("user hand\ntopic readwrite tacshade/#\n", "hand", "ok", ""),
        (f"user hand\ntopic read {BASE}/#\n", "hand", "fault", "user hand, then topic readwrite"),
        (SHIPPED, "hand", "fault", "topic readwrite"),  # another name than the sensor's
        ("topic write tacshade/#\n", None, "fault", "topic readwrite"),  # it must not be read
    ],
)
def test_access_rules(
    tmp_path: Path, rules: str, username: str | None, state: str, fix: str
) -> None:
    file = tmp_path / "acl"
    file.touch(0o600)
    file.write_text(rules)
    users = {"hand": "right"} if username else {}
    with Broker(tmp_path, users=users or None, more=(f"acl_file {file}",)) as broker:
        trip = ask(broker.port, username=username, password=users.get("hand"))[0][
            "broker round trip"
        ]
    assert trip.state == state
    assert fix in trip.fix


@pytest.mark.broker
def test_users(tmp_path: Path) -> None:
    with Broker(tmp_path, users={"hand": "right"}) as broker:
        wrong = trouble(broker.port, username="hand", password="wrong")
        assert wrong.fix.endswith("/etc/mosquitto/tacshade.passwd hand")
        assert "mqtt.username" in trouble(broker.port).fix


@pytest.mark.broker
@pytest.mark.parametrize(
    ("option", "found"),
    [
        ("max_packet_size 20000", "at most 20000 bytes"),
        ("message_size_limit 10000", "a message of 38000 bytes"),
    ],
)
def test_a_broker_that_takes_small_messages_only(tmp_path: Path, option: str, found: str) -> None:
    with Broker(tmp_path, more=(option,)) as broker:
        small = ask(broker.port)[0]["broker round trip"]
    assert small.state == "warning"
    assert found in small.found
    assert "message_size_limit" in small.fix


@pytest.mark.broker
def test_a_daemon_on_a_broker_that_takes_small_messages_only(tmp_path: Path) -> None:
    with (
        Broker(tmp_path, more=("max_packet_size 30000",)) as broker,
        Subscriber(broker.port, f"{BASE}/#") as other,
    ):
        other.publish(f"{BASE}/state", b"online", retain=True)
        other.wait_for(f"{BASE}/state")
        findings, daemon = ask(broker.port)
    assert findings["broker round trip"].state == "warning"
    assert daemon.state == "online"


@pytest.mark.broker
@pytest.mark.parametrize(
    ("option", "fix"),
    [("max_qos 0", "set max_qos to at least 1"), ("retain_available false", "retain_available")],
)
def test_a_broker_that_refuses_the_daemons_will(tmp_path: Path, option: str, fix: str) -> None:
    with Broker(tmp_path, more=(option,)) as broker:
        assert fix in trouble(broker.port).fix


@pytest.mark.broker
def test_a_broker_without_room(tmp_path: Path) -> None:
    with Broker(tmp_path, more=("max_connections 1",)) as broker, ExitStack() as clients:
        # Two have room: mosquitto 2.0.11 counts one too few after a connection that ends without a
        # word, as that which waits for its start. It may notice that end only after the first.
        for _ in range(4):
            clients.enter_context(a_client(broker.port))
        found = trouble(broker.port)
    assert "max_connections" in found.fix


@contextmanager
def a_client(port: int) -> Iterator[None]:
    """A client that stays connected if the broker accepts it."""
    with socket.create_connection(("127.0.0.1", port), patience(10)) as client:
        name = b"client-%d" % client.getsockname()[1]
        body = b"\x00\x04MQTT\x04\x02\x00\x3c\x00" + bytes([len(name)]) + name
        with suppress(ConnectionError):
            client.sendall(b"\x10" + bytes([len(body)]) + body)
            client.recv(4)
        yield


def test_a_broker_that_ends_the_connection_after_a_large_message() -> None:
    with HostileBroker(bytes_max=5000, echo=True) as broker:
        assert ask(broker.port)[0]["broker round trip"].state == "warning"


@pytest.mark.broker
def test_tls(tmp_path: Path) -> None:
    for name in ("ours", "theirs"):
        (tmp_path / name).mkdir()
    other = Broker(tmp_path / "theirs", tls=True)
    with Broker(tmp_path / "ours", tls=True) as broker:
        good, _ = ask(broker.port, tls_ca=str(broker.ca))
        assert good["broker"].state == "ok"
        wrong = trouble(broker.port, tls_ca=str(other.ca))
        assert wrong.fix.startswith("is mqtt.ca_file the PEM file")
        assert good["broker round trip"].state != "fault"
        named = trouble(broker.port, tls_ca=str(broker.ca), host="127.1")
        assert "is 127.1 a name in it (subjectAltName)" in named.fix
        assert "set mqtt.ca_file" in trouble(broker.port).fix
    with Broker(tmp_path / "theirs") as broker:
        assert (
            "omit mqtt.ca_file" in trouble(broker.port, tls_ca=str(tmp_path / "ours/cert.pem")).fix
        )


@pytest.mark.parametrize(
    ("daemon", "running", "state", "found"),
    [
        (DaemonState(), False, "ok", "not running"),
        (DaemonState("stopped"), False, "ok", "not running"),
        (
            DaemonState("online", fps=29.9),
            True,
            "ok",
            "process 5 (tacshade-edge run): online, 29.9 frames/s",
        ),
        (
            DaemonState("degraded", "no device", 0.0),
            True,
            "warning",
            "degraded, 0.0 frames/s, no device",
        ),
        (
            DaemonState("online"),
            False,
            "warning",
            "no daemon is running here, yet left is online on this broker",
        ),
        (
            DaemonState("online", place="on a", rival="on b"),
            True,
            "warning",
            "one is running on a, and the other is waiting on b",
        ),
        (DaemonState("offline"), True, "warning", "left is not online at the broker"),
        (
            DaemonState("online", place="on a, process 9", pid=9),
            True,
            "warning",
            "process 5 (tacshade-edge run) runs here, but left is online on a, process 9",
        ),
        (
            DaemonState("online", place="on b, process 5", elsewhere=True),
            True,
            "warning",
            "process 5 (tacshade-edge run) runs here, but left is online on b, process 5",
        ),
        (DaemonState("online", pid=5), True, "ok", "running, process 5 (tacshade-edge run)"),
    ],
)
def test_the_daemon(daemon: DaemonState, running: bool, state: str, found: str) -> None:
    finding = judge_daemon(
        daemon, Process(5, ("tacshade-edge", "run")) if running else None, "left"
    )
    assert finding.state == state
    assert found in finding.found
    assert bool(finding.fix) == (state != "ok")


def test_a_slow_round_trip() -> None:
    assert judge_round_trip(1.2) == ok(
        "broker round trip", "a 38 KB message made the round trip in 1.2 ms"
    )
    slow = judge_round_trip(41)
    assert slow.state == "warning"
    assert slow.fix.startswith("add `set_tcp_nodelay true`")
