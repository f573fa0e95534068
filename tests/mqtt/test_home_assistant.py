"""What is announced to Home Assistant, as its documentation asks for it, and through a broker."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.mqtt_rig import Broker, Subscriber
from support.patience import wait_until
from support.published_sensor import bump, unmeasured
from tacshade_edge.mqtt.client import broker_at
from tacshade_edge.mqtt.home_assistant import (
    STATUS,
    HomeAssistant,
    discovery_topics,
    encode_discovery,
)
from tacshade_edge.mqtt.link import MqttLink
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import Reconstruction
from tacshade_edge.wire import messages

ANNOUNCED = encode_discovery("left-index", version="0.1.0", profiles=tuple(PROFILES))
COMMON = {"name", "unique_id", "device", "origin", "availability", "availability_mode"}
KINDS: dict[
    str, tuple[set[str], set[str]]
] = {  # keys that a component needs, and may have: others it leaves out
    "sensor": (
        {"state_topic"},
        {
            "value_template",
            "unit_of_measurement",
            "device_class",
            "state_class",
            "suggested_display_precision",
            "expire_after",
        },
    ),
    "binary_sensor": ({"state_topic", "value_template"}, {"expire_after"}),
    "event": ({"state_topic", "event_types"}, {"value_template", "qos"}),
    "select": (
        {"command_topic", "command_template", "state_topic", "value_template", "options", "qos"},
        set(),
    ),
    "button": ({"command_topic", "payload_press", "qos"}, set()),
}


@pytest.mark.parametrize("topic", discovery_topics("left-index"))
def test_it_is_as_the_documentation_says(topic: str) -> None:
    root, component, node, name, end = topic.split("/")
    assert (root, node, end) == ("homeassistant", "left-index", "config")
    entity = json.loads(ANNOUNCED[topic])
    needed, may = KINDS[component]
    assert COMMON | needed <= set(entity) <= COMMON | needed | may | {"entity_category"}
    assert entity["unique_id"] == f"tacshade_left-index_{name}"
    assert entity.get("entity_category", "config") in ("config", "diagnostic")
    offered = [profile for profile in PROFILES if profile != "paper"]
    assert entity.get("options", offered) == offered
    assert set(entity["device"]) == {"identifiers", "name", "model", "sw_version"}
    assert set(entity["origin"]) == {"name", "sw_version"}
    needed = ["state", "status/camera"] if name in ("depth", "contact", "touches") else ["state"]
    topics = [f"tacshade/left-index/{each}" for each in needed]
    assert [each["topic"] for each in entity["availability"]] == topics
    assert all(set(each) == {"topic", "value_template"} for each in entity["availability"])
    topics = [value for key, value in entity.items() if key.endswith("_topic")]
    assert all(re.fullmatch(r"tacshade/left-index/[a-z_/]+", one) for one in topics)


def test_what_is_announced_is_what_would_be_taken_back() -> None:
    assert tuple(ANNOUNCED) == discovery_topics("left-index")
    assert len({json.loads(payload)["unique_id"] for payload in ANNOUNCED.values()}) == len(
        ANNOUNCED
    )


@pytest.mark.parametrize(
    ("result", "contact", "depth"),
    [
        (bump(1, 1.26, 236, 328, 8), "ON", "1.3"),
        (bump(1, 0.0, 0, 0, 8), "OFF", "0.0"),
        (unmeasured(1), "ON", "None"),  # which Home Assistant takes for unknown
    ],
    ids=["contact", "no contact", "touched"],
)
def test_home_assistant_shows_each_of_the_three_answers(
    result: Reconstruction, contact: str, depth: str
) -> None:
    jinja2 = pytest.importorskip("jinja2")
    value = json.loads(messages.encode_contact(result, fps=1.0))
    shown = {
        name: jinja2.Template(json.loads(ANNOUNCED[topic])["value_template"]).render(
            value_json=value
        )
        for topic in ANNOUNCED
        for name in ("contact", "depth")
        if f"/{name}/config" in topic
    }
    assert shown == {"contact": contact, "depth": depth}


USERS = ("hand", "other", "homeassistant")

TOPICS = discovery_topics("hand")


@contextmanager
def announcing(
    port: int, *, user: str = "hand", wanted: bool
) -> Iterator[tuple[MqttLink, HomeAssistant]]:
    """What of a daemon named `hand` announces it."""
    link = MqttLink(
        broker_at("127.0.0.1", port, username=user, password=user),
        base_topic="tacshade/hand",
        client_id="tacshade-hand",
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


def announced_state(assistant: Subscriber) -> str:
    payloads = assistant.of(f"tacshade/hand/{STATUS}")
    return str(json.loads(payloads[-1])["state"]) if payloads else ""


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[Broker]:
    rules = tmp_path / "acl"
    rules.touch(0o600)
    rules.write_text((Path(__file__).parents[2] / "systemd/mosquitto-tacshade.acl").read_text())
    with Broker(
        tmp_path, users={name: name for name in USERS}, more=(f"acl_file {rules}",)
    ) as made:
        yield made


def eyes(guarded: Broker) -> Subscriber:
    """Home Assistant's: what it may read."""
    subscriber = Subscriber(guarded.port)
    subscriber.client.username_pw_set("homeassistant", "homeassistant")
    return subscriber


@pytest.fixture
def assistant(guarded: Broker) -> Iterator[Subscriber]:
    with eyes(guarded) as subscriber:
        yield subscriber


@pytest.mark.broker
def test_it_is_announced_and_taken_back(guarded: Broker, assistant: Subscriber) -> None:
    with announcing(guarded.port, wanted=True) as (link, announcer):
        wait_until(lambda: announced_state(assistant) == "announced", 10, "the announcement")
        wait_until(lambda: all(assistant.of(topic) for topic in TOPICS), 10, "announced")
        select = next(topic for topic in TOPICS if "/select/" in topic)
        assert json.loads(assistant.of(select)[-1])["options"] == ["fast"]
        announcer.announce(["fast", "paper"])  # nothing new
        announcer.announce(["fast", "paper", "auto"])
        wait_until(lambda: len(assistant.of(select)) == 2, 10, "announced anew")
        assert json.loads(assistant.of(select)[-1])["options"] == ["fast", "auto"]
        assert link.counters()["refused"] == 0
    with announcing(guarded.port, wanted=False) as (link, _):
        wait_until(lambda: announced_state(assistant) == "withdrawn", 10, "the announcement")
        wait_until(
            lambda: all(assistant.of(topic)[-1] == b"" for topic in TOPICS), 10, "taken back"
        )
        assert link.counters()["refused"] == 0
    with eyes(guarded) as later:
        later.wait_for(f"tacshade/hand/{STATUS}")
        assert not [m for m in later.messages if m.topic.startswith("homeassistant/")]
