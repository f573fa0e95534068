"""What is announced to Home Assistant, as its documentation asks for it."""

from __future__ import annotations

import json
import re

import pytest

from support.published_sensor import bump, unmeasured
from tacshade_edge.mqtt.home_assistant import discovery_topics, encode_discovery
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
