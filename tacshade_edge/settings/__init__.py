"""Strict settings: reads a YAML file as frozen `Settings`, or says in one line what is wrong and
where.

In: a YAML file. Out: a `Document`.
Threads: none.
Other rooms use: `conversion`, `load`, `model`, `strict_yaml`.
"""

from tacshade_edge.settings.load import Document, Hand, load, load_all, load_hand, to_yaml
from tacshade_edge.settings.model import (
    Files,
    Mqtt,
    Recorder,
    Rpicam,
    Serial,
    Settings,
    Simulated,
    Source,
    V4l2,
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
    "digest",
    "file_schema",
    "json_schema",
    "load",
    "load_all",
    "load_hand",
    "to_yaml",
]
