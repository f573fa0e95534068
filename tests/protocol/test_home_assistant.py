"""What is announced, against Home Assistant's documentation."""

from __future__ import annotations

import json
from typing import Annotated, Literal

import msgspec
import pytest
from msgspec import Meta

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.protocol.home_assistant import discovery_topics, encode_discovery

ANNOUNCED = encode_discovery("left-index", version="0.1.0", profiles=tuple(PROFILES))
Text = Annotated[str, Meta(min_length=1)]
Topic = Annotated[str, Meta(pattern=r"^tacshade/left-index/[a-z_/]+$")]


class Strict(msgspec.Struct, forbid_unknown_fields=True):
    """No key that Home Assistant would silently leave out."""


class Device(Strict):
    identifiers: Annotated[list[Text], Meta(min_length=1)]
    name: Text
    model: Text
    sw_version: Text


class Origin(Strict):
    name: Text
    sw_version: Text


class Availability(Strict):
    topic: Topic
    value_template: Text


class Entity(Strict, kw_only=True):
    name: Text
    unique_id: Text
    device: Device
    origin: Origin
    availability: Annotated[list[Availability], Meta(min_length=1)]
    entity_category: Literal["config", "diagnostic"] | None = None


class Sensor(Entity, kw_only=True):
    state_topic: Topic
    value_template: Text | None = None
    unit_of_measurement: Literal["mm"] | None = None
    device_class: Literal["distance"] | None = None
    state_class: Literal["measurement"] | None = None
    suggested_display_precision: Annotated[int, Meta(ge=0)] | None = None


class BinarySensor(Entity, kw_only=True):
    state_topic: Topic
    value_template: Text


class Select(Entity, kw_only=True):
    command_topic: Topic
    command_template: Text
    state_topic: Topic
    value_template: Text
    options: Annotated[list[Text], Meta(min_length=1)]
    qos: Literal[0, 1, 2]


class Button(Entity, kw_only=True):
    command_topic: Topic
    payload_press: Text
    qos: Literal[0, 1, 2]


KINDS = {"sensor": Sensor, "binary_sensor": BinarySensor, "select": Select, "button": Button}


@pytest.mark.parametrize("topic", discovery_topics("left-index"))
def test_it_is_as_the_documentation_says(topic: str) -> None:
    root, component, node, name, end = topic.split("/")
    assert (root, node, end) == ("homeassistant", "left-index", "config")
    entity = msgspec.json.decode(ANNOUNCED[topic], type=KINDS[component])
    assert entity.unique_id == f"tacshade_left-index_{name}"
    assert entity.availability[0].topic == "tacshade/left-index/state"


def test_what_is_announced_is_what_would_be_taken_back() -> None:
    assert tuple(ANNOUNCED) == discovery_topics("left-index")
    assert len({json.loads(payload)["unique_id"] for payload in ANNOUNCED.values()}) == len(ANNOUNCED)
