"""Strict settings: one YAML file to one frozen `Settings`, or one line that says what is wrong and where."""

from tacshade_edge.settings.load import Document, load, to_yaml
from tacshade_edge.settings.model import (
    Files,
    Mqtt,
    Recorder,
    Serial,
    Settings,
    Simulated,
    Source,
    V4l2,
    digest,
    json_schema,
)

__all__ = [
    "Document",
    "Files",
    "Mqtt",
    "Recorder",
    "Serial",
    "Settings",
    "Simulated",
    "Source",
    "V4l2",
    "digest",
    "json_schema",
    "load",
    "to_yaml",
]
