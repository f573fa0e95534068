"""Checks of the files and devices that the settings name, before the daemon opens them."""

from __future__ import annotations

from tacshade_edge.mqtt.links import check_broker_files
from tacshade_edge.robot.ports import check_serial
from tacshade_edge.settings import Document, check_source


def check_files(document: Document) -> None:
    """Check the paths of the source and the serial port, and the broker's files.

    Raises ConfigError.
    """
    check_source(document)
    check_broker_files(document)
    check_serial(document)
