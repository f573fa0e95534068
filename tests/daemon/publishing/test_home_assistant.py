"""A hand comes to Home Assistant and goes again, through the access rules that are shipped; a real mosquitto."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tacshade_edge.daemon.publishing import STATUS, HomeAssistant
from tacshade_edge.devices.mqtt.link import MqttLink
from tacshade_edge.protocol.home_assistant import discovery_topics
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.patience import wait_until

pytestmark = [pytest.mark.broker, pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")]
USERS = ("hand", "other", "homeassistant")
TOPICS = discovery_topics("hand")


@contextmanager
def running(port: int, *, user: str = "hand", wanted: bool) -> Iterator[tuple[MqttLink, HomeAssistant]]:
    """What of a daemon named `hand` announces it."""
    link = MqttLink(
        host="127.0.0.1",
        port=port,
        base_topic="tacshade/hand",
        client_id="tacshade-hand",
        username=user,
        password=user,
        on_request=lambda _: None,
        on_outcome=lambda *_: None,
    )
    announcer = HomeAssistant(link, "hand", wanted=wanted)
    announcer.announce(["fast", "paper"])
    link.start()
    try:
        wait_until(lambda: link.connected, 10, "connected")
        yield link, announcer
    finally:
        link.stop(2)


def state(seen: Subscriber) -> str:
    told = seen.of(f"tacshade/hand/{STATUS}")
    return str(json.loads(told[-1])["state"]) if told else ""


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    rules = tmp_path / "acl"
    rules.touch(0o600)
    rules.write_text((Path(__file__).parents[3] / "systemd/mosquitto-tacshade.acl").read_text())
    with Broker(tmp_path, users={name: name for name in USERS}, more=(f"acl_file {rules}",)) as made:
        yield made


def eyes(broker: Broker) -> Subscriber:
    """Home Assistant's: what it may read."""
    subscriber = Subscriber(broker.port)
    subscriber.client.username_pw_set("homeassistant", "homeassistant")
    return subscriber


@pytest.fixture
def seen(broker: Broker) -> Iterator[Subscriber]:
    with eyes(broker) as subscriber:
        yield subscriber


def test_it_is_announced_and_taken_back(broker: Broker, seen: Subscriber) -> None:
    with running(broker.port, wanted=True) as (link, announcer):
        wait_until(lambda: state(seen) == "announced", 10, "told")
        wait_until(lambda: all(seen.of(topic) for topic in TOPICS), 10, "announced")
        select = next(topic for topic in TOPICS if "/select/" in topic)
        assert json.loads(seen.of(select)[-1])["options"] == ["fast", "paper"]
        announcer.announce(["fast", "paper"])  # nothing new
        announcer.announce(["fast", "paper", "auto"])
        wait_until(lambda: len(seen.of(select)) == 2, 10, "announced anew")
        assert json.loads(seen.of(select)[-1])["options"] == ["fast", "paper", "auto"]
        assert link.counters()["refused"] == 0
    with running(broker.port, wanted=False) as (link, _):
        wait_until(lambda: state(seen) == "withdrawn", 10, "told")
        wait_until(lambda: all(seen.of(topic)[-1] == b"" for topic in TOPICS), 10, "taken back")
        assert link.counters()["refused"] == 0
    with eyes(broker) as later:
        later.wait_for(f"tacshade/hand/{STATUS}")
        assert not [m for m in later.messages if m.topic.startswith("homeassistant/")]


def test_who_never_announced_writes_nothing_elsewhere(broker: Broker, seen: Subscriber) -> None:
    with running(broker.port, wanted=False):
        wait_until(lambda: b"online" in seen.of("tacshade/hand/state"), 10, "online")
    wait_until(lambda: b"stopped" in seen.of("tacshade/hand/state"), 10, "stopped")
    assert {m.topic.split("/")[0] for m in seen.messages} == {"tacshade"}


def test_no_hand_announces_another(broker: Broker, seen: Subscriber) -> None:
    with running(broker.port, user="other", wanted=True) as (link, _):
        wait_until(lambda: link.counters()["refused"] >= len(TOPICS), 10, "refused")
    assert not [m for m in seen.messages if m.topic.startswith("homeassistant/")]
