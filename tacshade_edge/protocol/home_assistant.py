"""Announce a sensor to Home Assistant by MQTT discovery: one retained message for each entity.

https://www.home-assistant.io/integrations/mqtt/#mqtt-discovery
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import msgspec

_ENTITIES: Final = {
    "depth": "sensor",
    "contact": "binary_sensor",
    "state": "sensor",
    "profile": "select",
    "rezero": "button",
}


def discovery_topics(sensor_id: str) -> tuple[str, ...]:
    """The full topics of the announcements."""
    return tuple(f"homeassistant/{component}/{sensor_id}/{name}/config" for name, component in _ENTITIES.items())


def encode_discovery(sensor_id: str, *, version: str, profiles: Sequence[str]) -> dict[str, bytes]:
    """The announcements by topic; `profiles` are the names that ``req/profile`` accepts.

    The depth is rounded to 0.1 mm because `contact` comes with every frame and Home Assistant stores each value that
    differs from the previous one.
    """
    base = f"tacshade/{sensor_id}"
    common = {
        "device": {
            "identifiers": [f"tacshade_{sensor_id}"],
            "name": f"TacShade {sensor_id}",
            "model": "TacShade",
            "sw_version": version,
        },
        "origin": {"name": "tacshade-edge", "sw_version": version},
        "availability": [
            {
                "topic": f"{base}/state",
                "value_template": "{{ 'online' if value in ('online', 'degraded') else 'offline' }}",
            }
        ],
    }
    entities: dict[str, dict[str, Any]] = {
        "depth": {
            "name": "Depth",
            "state_topic": f"{base}/contact",
            "value_template": "{{ value_json.depth_max_mm | round(1) }}",
            "unit_of_measurement": "mm",
            "device_class": "distance",
            "state_class": "measurement",
            "suggested_display_precision": 1,
        },
        "contact": {
            "name": "Contact",
            "state_topic": f"{base}/contact",
            "value_template": "{{ 'ON' if value_json.contact else 'OFF' }}",
        },
        "state": {
            "name": "State",
            "state_topic": f"{base}/state",
            "entity_category": "diagnostic",
        },
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
    return {
        topic: msgspec.json.encode({**entities[name], "unique_id": f"tacshade_{sensor_id}_{name}", **common})
        for topic, name in zip(discovery_topics(sensor_id), _ENTITIES, strict=True)
    }
