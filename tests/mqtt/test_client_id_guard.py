"""Two under one name at a real mosquitto: the first keeps the broker,
the second waits and says for whom.
"""

from __future__ import annotations

import json
import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from support.link_rig import BASE, Rig, code
from support.mqtt_rig import Broker, Subscriber
from support.patience import wait_until
from tacshade_edge.reasons import ReasonCode

pytestmark = pytest.mark.broker


@contextmanager
def daemon(port: int) -> Iterator[Rig]:
    """A link that reports its health as a daemon does."""
    rig, ended = Rig(port), threading.Event()

    def report() -> None:
        while not ended.wait(0.5):
            rig.link.set_retained("health", b"{}", qos=0)

    reporter = threading.Thread(target=report)
    reporter.start()
    rig.link.start()
    try:
        yield rig
    finally:
        ended.set()
        reporter.join()
        rig.link.stop(2)


def test_the_second_waits_says_for_whom_and_takes_nothing(
    broker: Broker, caplog: pytest.LogCaptureFixture
) -> None:
    with daemon(broker.port) as first, Subscriber(broker.port, f"{BASE}/#", v5=True) as subscriber:
        wait_until(lambda: first.link.connected, 10, "connected")
        with daemon(broker.port) as second:
            wait_until(lambda: code(second) is ReasonCode.IN_USE, 10, "the reason")
            reason = (
                f"another daemon, on {socket.gethostname()}, process {os.getpid()}, is using {BASE}"
            )
            assert reason in str(second.link.reason)
            status = json.loads(subscriber.wait_for(f"{BASE}/status/rival")[-1])
            assert (status["state"], status["reason_code"]) == ("waiting", "in_use")
            assert status["process"] == os.getpid()
            (rival, *_) = [
                m for m in list(subscriber.messages) if m.topic == f"{BASE}/status/rival"
            ]
            assert rival.properties is not None
            assert rival.properties.ContentType == "application/json"
            have = len(subscriber.of(f"{BASE}/health"))
            subscriber.wait_for(f"{BASE}/health", have + 6, 10)
            assert not second.link.connected
        wait_until(lambda: subscriber.of(f"{BASE}/status/rival")[-1] == b"", 5, "the rival is gone")
        assert first.link.counters()["losses"] == 0
        assert set(subscriber.of(f"{BASE}/state")) == {b"online"}
    assert caplog.text.count("another daemon, on") == 1


def test_the_second_follows_when_the_first_is_gone_for_good(broker: Broker) -> None:
    with daemon(broker.port) as first:
        wait_until(lambda: first.link.connected, 10, "connected")
        with daemon(broker.port) as second:
            wait_until(lambda: code(second) is ReasonCode.IN_USE, 10, "the reason")
            first.link.stop(2)
            wait_until(lambda: second.link.connected, 20, "connected")


def test_a_broker_that_restarts_gives_the_name_back_to_the_first(broker: Broker) -> None:
    with daemon(broker.port) as first:
        wait_until(lambda: first.link.connected, 10, "connected")
        with daemon(broker.port) as second:
            wait_until(lambda: code(second) is ReasonCode.IN_USE, 10, "the reason")
            broker.kill()
            wait_until(
                lambda: not first.link.connected and code(second) is not ReasonCode.IN_USE,
                10,
                "lost",
            )
            broker.start()
            wait_until(lambda: code(second) is ReasonCode.IN_USE, 10, "waits again")
            assert first.link.connected
            assert not second.link.connected


def test_what_a_dead_daemon_left_does_not_keep_anybody_out(broker: Broker) -> None:
    with Subscriber(broker.port) as other:
        for name, payload in (
            ("state", b"online"),
            ("instance", b'{"id": "x"}'),
            ("health", b"{}"),
        ):
            other.publish(f"{BASE}/{name}", payload, retain=True)
            other.wait_for(f"{BASE}/{name}")
    with daemon(broker.port) as late:
        wait_until(lambda: late.link.connected, 10, "connected")
