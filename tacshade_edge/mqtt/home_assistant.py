"""The announcement of a sensor in Home Assistant, and its withdrawal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import msgspec

from tacshade_edge.mqtt.link import MqttLink
from tacshade_edge.version import installed_version
from tacshade_edge.wire.messages import encode_status
from tacshade_edge.wire.topics import decode_status

_ENTITIES: Final = {
    "depth": "sensor",
    "contact": "binary_sensor",
    "touches": "event",
    "state": "sensor",
    "profile": "select",
    "rezero": "button",
}
# Home Assistant takes None for unknown, as it is while frames are unusable. A touch without a depth
# is on: whoever waits for a touch must not miss one.
_DEPTH_TEMPLATE: Final = (
    "{{ None if value_json.depth_max_mm is none else value_json.depth_max_mm | round(1) }}"
)
_CONTACT_TEMPLATE: Final = (
    "{{ None if value_json.contact is none"
    " else 'ON' if value_json.contact or value_json.touched else 'OFF' }}"
)
# `contact` comes at least once a second; an older value is none of now.
_EXPIRE_S: Final = 5
_RUNS_TEMPLATE: Final = "{{ 'online' if value in ('online', 'degraded') else 'offline' }}"
_STREAMS_TEMPLATE: Final = "{{ 'online' if value_json.state == 'streaming' else 'offline' }}"
# What a frame says, which is unknown without usable frames, while the daemon runs.
_OF_FRAMES: Final = ("depth", "contact", "touches")


def discovery_topics(sensor_id: str) -> tuple[str, ...]:
    """The full topics of the announcements."""
    return tuple(
        f"homeassistant/{component}/{sensor_id}/{name}/config"
        for name, component in _ENTITIES.items()
    )


def _entities(base: str, profiles: Sequence[str]) -> dict[str, dict[str, Any]]:
    """What differs between the entities, by their names."""
    return {
        "depth": {
            "name": "Depth",
            "state_topic": f"{base}/contact",
            "value_template": _DEPTH_TEMPLATE,
            "unit_of_measurement": "mm",
            "device_class": "distance",
            "state_class": "measurement",
            "suggested_display_precision": 1,
            "expire_after": _EXPIRE_S,
        },
        "contact": {
            "name": "Contact",
            "state_topic": f"{base}/contact",
            "value_template": _CONTACT_TEMPLATE,
            "expire_after": _EXPIRE_S,
        },
        "touches": {
            "name": "Touches",
            "state_topic": f"{base}/event/contact",
            "value_template": "{{ dict(value_json, event_type=value_json.type) | to_json }}",
            "event_types": ["new", "update", "end"],
            "qos": 1,
        },
        "state": {"name": "State", "state_topic": f"{base}/state", "entity_category": "diagnostic"},
        "profile": {
            "name": "Profile",
            "state_topic": f"{base}/info",
            "value_template": "{{ value_json.choice }}",
            "command_topic": f"{base}/req/profile",
            "command_template": '{"profile": "{{ value }}"}',
            "qos": 1,
            "options": [name for name in profiles if name != "paper"],  # a baseline of studies
            "entity_category": "config",
        },
        "rezero": {
            "name": "Re-zero",
            "command_topic": f"{base}/req/reference",
            "payload_press": "{}",
            "qos": 1,
            "entity_category": "config",
        },
    }


def encode_discovery(sensor_id: str, *, version: str, profiles: Sequence[str]) -> dict[str, bytes]:
    """The announcements by topic (https://www.home-assistant.io/integrations/mqtt/#mqtt-discovery).

    The depth is rounded because Home Assistant stores each value that differs
    from the previous one.
    """
    base = f"tacshade/{sensor_id}"
    runs = {"topic": f"{base}/state", "value_template": _RUNS_TEMPLATE}
    streams = {"topic": f"{base}/status/camera", "value_template": _STREAMS_TEMPLATE}
    device = {
        "identifiers": [f"tacshade_{sensor_id}"],
        "name": f"TacShade {sensor_id}",
        "model": "TacShade",
    }
    common = {
        "device": {**device, "sw_version": version},
        "origin": {"name": "tacshade-edge", "sw_version": version},
        "availability_mode": "all",
    }
    entities = _entities(base, profiles)
    return {
        topic: msgspec.json.encode(
            {
                **entities[name],
                "unique_id": f"tacshade_{sensor_id}_{name}",
                "availability": [runs, streams] if name in _OF_FRAMES else [runs],
                **common,
            }
        )
        for topic, name in zip(discovery_topics(sensor_id), _ENTITIES, strict=True)
    }


STATUS = "status/home_assistant"
ANNOUNCED, WITHDRAWN = "announced", "withdrawn"


class HomeAssistant:
    """Announces the sensor in Home Assistant if the settings want it, and withdraws it once they no
    longer do: retained announcements outlive the daemon, and so does the status that reports them.
    """

    def __init__(self, link: MqttLink, sensor_id: str, *, wanted: bool) -> None:
        self._link, self._sensor_id, self._wanted = link, sensor_id, wanted
        self._announced: tuple[str, ...] | None = None
        if not wanted:
            link.watch(STATUS, self._withdraw)

    def announce(self, profiles: Sequence[str]) -> None:
        """Announce the sensor if the settings want it and the profiles are new."""
        if not self._wanted or self._announced == tuple(profiles):
            return
        # The announcement lists the profiles, so other profiles are another announcement.
        self._announced = tuple(profiles)
        for topic, payload in encode_discovery(
            self._sensor_id, version=installed_version(), profiles=profiles
        ).items():
            self._link.set_retained(f"/{topic}", payload)
        self._link.set_retained(STATUS, encode_status(ANNOUNCED))

    def _withdraw(self, status: bytes) -> None:
        """Withdraw what an earlier run announced, according to its status. Raises DecodeError."""
        if decode_status(STATUS, status).state == ANNOUNCED:
            for topic in discovery_topics(self._sensor_id):
                # An empty retained value removes the entity, and the value from the broker.
                self._link.set_retained(f"/{topic}", b"")
            self._link.set_retained(STATUS, encode_status(WITHDRAWN))
