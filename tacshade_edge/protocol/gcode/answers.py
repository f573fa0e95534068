"""Parse the lines that a printer answers."""

from __future__ import annotations

import re
from dataclasses import dataclass

_NUMBER = rb"(-?\d{1,6}(?:\.\d{1,6})?)"
_POSITION = re.compile(rb"(?:^|\s)X:\s*%b\s+Y:\s*%b\s+Z:\s*%b(?:\s|$)" % (_NUMBER, _NUMBER, _NUMBER))
_RESEND = re.compile(rb"(?:resend|rs)[: ]\s*N?\s*(\d{1,9})\s*$", re.IGNORECASE)
# After a reset, noise may precede the word.
_START = re.compile(rb"(?:^|.*[^ -~])start$")
# Errors that report a damaged line: the printer requests it again in its next line.
_ASKED_AGAIN = re.compile(rb"error:.*(?:checksum|line number)", re.IGNORECASE)
_FAILED = re.compile(rb"error:|!!|// klipper state: (?:shutdown|disconnect)|.*unknown command|.*home .*first", re.I)
_RESTARTED = re.compile(rb"// klipper state: (?:startup|ready)", re.IGNORECASE)
_BUSY = re.compile(rb"(?:echo:\s*)?busy:", re.IGNORECASE)
_OK = re.compile(rb"ok(?![a-z])", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Ok:
    """The printer accepted the command."""


@dataclass(frozen=True, slots=True)
class Busy:
    """The printer is alive and still executing the command."""


@dataclass(frozen=True, slots=True)
class Resend:
    """The printer requests the line with this number again."""

    number: int


@dataclass(frozen=True, slots=True)
class Failed:
    """The printer cannot execute the command, or has stopped."""

    text: str


@dataclass(frozen=True, slots=True)
class Restarted:
    """The printer restarted and lost its position."""


@dataclass(frozen=True, slots=True)
class Position:
    """The position in mm that the printer was sent to."""

    x_mm: float
    y_mm: float
    z_mm: float


@dataclass(frozen=True, slots=True)
class Said:
    """Any other line: temperatures, a name, a debug line."""

    text: str


Answer = Ok | Busy | Resend | Failed | Restarted | Position | Said


def parse(line: bytes) -> tuple[Answer, ...]:
    """Parse a line without its end: no answer, a position and its `Ok`, or one answer; never raises."""
    line = line.strip()
    if not line:
        return ()
    text = line.decode("ascii", "replace")
    position = tuple(Position(*map(float, found.groups())) for found in _POSITION.finditer(line))[:1]
    if _OK.match(line):
        return (*position, Ok())
    if position and line.startswith(b"X:"):
        return position
    if found := _RESEND.match(line):
        return (Resend(int(found[1])),)
    if _START.match(line) or _RESTARTED.match(line):
        return (Restarted(),)
    if _BUSY.match(line):
        return (Busy(),)
    if _FAILED.match(line) and not _ASKED_AGAIN.match(line):
        return (Failed(text),)
    return (Said(text),)
