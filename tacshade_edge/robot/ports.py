"""The robot's port that the settings name, and its check, which does not open it.

pyserial is imported only where there is a port.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tacshade_edge.errors import ConfigError
from tacshade_edge.settings import Document, Serial

if TYPE_CHECKING:
    from tacshade_edge.robot.port import SerialPort


def make_serial_port(settings: Serial | None) -> SerialPort | None:
    """Make the robot's port that the settings name, without opening it;
    None, without pyserial, if there is none.
    """
    if settings is None:
        return None
    from tacshade_edge.robot.port import SerialPort

    return SerialPort(settings.device, settings.baud, dtr=settings.dtr)


def check_serial(document: Document) -> None:
    """Check that the robot's port, if present, is a serial device. Raises ConfigError."""
    if (settings := document.settings.serial) is None:
        return
    from tacshade_edge.robot.port import check_kind

    try:
        check_kind(settings.device)
    except ConfigError as error:
        raise ConfigError(f"{document.where('serial', 'device')}: {error}") from None
