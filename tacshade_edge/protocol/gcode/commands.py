"""Encode G-code commands for a printer.

References
----------
Marlin's documentation of G-code (marlinfw.org/meta/gcode) and the RepRap wiki's page "G-code": line numbers, the
checksum (all bytes before the asterisk, XORed), and every command here.
"""

from __future__ import annotations

from functools import reduce
from operator import xor
from typing import Final

EMERGENCY_STOP: Final = b"\nM112\n"
"""Printers obey it at once and without a line number; the leading line end terminates any half-sent line."""

FIRMWARE: Final = "M115"
MILLIMETRES: Final = "G21"
ABSOLUTE: Final = "G90"
HOME: Final = "G28"
WAIT_FOR_MOTION: Final = "M400"
POSITION: Final = "M114"


def numbered(number: int, command: str) -> bytes:
    """A line with its number (0 to 2³¹ - 1) and checksum, so that a printer requests a damaged line again."""
    text = f"N{number} {command}".encode("ascii")
    return text + b"*%d\n" % reduce(xor, text, 0)


def first_number(number: int) -> str:
    """The command that sets the printer's current line number to `number`."""
    return f"M110 N{number}"


def straight(x_mm: float, y_mm: float, z_mm: float, feed_mm_s: float) -> str:
    """The command for a straight move to a position, rounded to 1 µm, at a feed rounded down to whole mm/min.

    Raises
    ------
    ValueError
        The position is not within ±1e6 mm, or the feed is below 1 mm/min.
    """
    feed_mm_min = int(60 * feed_mm_s)
    if feed_mm_min < 1:
        raise ValueError(f"a feed of {feed_mm_s} mm/s is none")
    words = []
    for axis, value_mm in (("X", x_mm), ("Y", y_mm), ("Z", z_mm)):
        if not abs(value_mm) < 1e6:
            raise ValueError(f"{axis} {value_mm} is no place")
        words.append(f"{axis}{round(value_mm, 3) + 0.0:.3f}")  # no -0.000
    return f"G1 {' '.join(words)} F{feed_mm_min}"


def stay_awake(firmware: str) -> str:
    """The command that keeps idle motors on: a printer that switches them off loses its position without notice.

    Klipper interprets Marlin's command as one that switches them off.
    """
    return "SET_IDLE_TIMEOUT TIMEOUT=86400" if "klipper" in firmware.lower() else "M84 S0"
