"""Strict settings: one YAML file to one frozen `Settings`, or one line that says what is wrong and where."""

from tacshade_edge.settings.load import Document, load
from tacshade_edge.settings.model import Files, Mqtt, Settings, Simulated, Source, V4l2, digest, json_schema

__all__ = [
    "Document",
    "Files",
    "Mqtt",
    "Settings",
    "Simulated",
    "Source",
    "V4l2",
    "digest",
    "json_schema",
    "load",
]
