"""Strict settings: reads a YAML file as frozen `Settings`, or says in one line what is wrong and
where.

In: a YAML file. Out: a `Document`.
Threads: none.
Other rooms use: `conversion`, `load`, `model`, `strict_yaml`.
"""

from tacshade_edge.camera.sources import Files, Rpicam, Simulated, Source, V4l2
from tacshade_edge.settings.load import (
    Document,
    Hand,
    check_source,
    doubted_finger,
    load,
    load_all,
    load_hand,
    to_yaml,
)
from tacshade_edge.settings.model import (
    Mqtt,
    Recorder,
    Serial,
    Settings,
    digest,
    file_schema,
    json_schema,
)

__all__ = [
    "Document",
    "Files",
    "Hand",
    "Mqtt",
    "Recorder",
    "Rpicam",
    "Serial",
    "Settings",
    "Simulated",
    "Source",
    "V4l2",
    "check_source",
    "digest",
    "doubted_finger",
    "file_schema",
    "json_schema",
    "load",
    "load_all",
    "load_hand",
    "to_yaml",
]
