"""What is announced, against Home Assistant's documentation."""

from __future__ import annotations

import json
import re

import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.protocol.home_assistant import discovery_topics, encode_discovery

ANNOUNCED = encode_discovery("left-index", version="0.1.0", profiles=tuple(PROFILES))
COMMON = {"name", "unique_id", "device", "origin", "availability"}
KINDS: dict[str, tuple[set[str], set[str]]] = {  # keys that a component needs, and may have: others it leaves out
    "sensor": (
        {"state_topic"},
        {"value_template", "unit_of_measurement", "device_class", "state_class", "suggested_display_precision"},
    ),
    "binary_sensor": ({"state_topic", "value_template"}, set()),
    "select": ({"command_topic", "command_template", "state_topic", "value_template", "options", "qos"}, set()),
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
    (availability,) = entity["availability"]
    assert (set(availability), availability["topic"]) == ({"topic", "value_template"}, "tacshade/left-index/state")
    topics = [value for key, value in entity.items() if key.endswith("_topic")]
    assert all(re.fullmatch(r"tacshade/left-index/[a-z_/]+", one) for one in topics)


def test_what_is_announced_is_what_would_be_taken_back() -> None:
    assert tuple(ANNOUNCED) == discovery_topics("left-index")
    assert len({json.loads(payload)["unique_id"] for payload in ANNOUNCED.values()}) == len(ANNOUNCED)
