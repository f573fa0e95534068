"""G-code on a serial line, as Marlin, Klipper, RepRapFirmware, Smoothieware and Prusa's firmwares understand it.

References
----------
Marlin's documentation of G-code (marlinfw.org/meta/gcode) and the RepRap wiki's page "G-code": line numbers, the
checksum (all bytes before the asterisk, XORed), and every command here; Duet's page on M114; Klipper's ``gcode.py``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
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

    Raises ValueError for a position beyond ±1e6 mm, or a feed below 1 mm/min.
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


_NUMBER = rb"[+-]?(?:\d{1,6}(?:\.\d{0,6})?|\.\d{1,6})"
_IS_POSITION = re.compile(rb"(?:echo:|//)?\s*(?:C:\s*)?X[:=]", re.IGNORECASE)
_AXIS = re.compile(rb"(?<![A-Z])([XYZ])[:=]\s*(%b)(?=[\s;]|,(?!\d)|[A-Z][:=]|$)" % _NUMBER, re.IGNORECASE)
# What follows are motor steps or other frames of reference.
_POSITION_END = re.compile(rb"\bcount\b|\bmachine\b", re.IGNORECASE)
_FIRMWARE = re.compile(r"FIRMWARE_NAME:\s*(.*?)(?=[,;]?\s+[A-Z][A-Z_-]+:|$)")
_STAY_AWAKE: Final = (  # the start of a firmware's name
    (re.compile(r"(?:danger-)?klipper|kalico", re.I), "SET_IDLE_TIMEOUT TIMEOUT=86400"),
    (re.compile(r"marlin|prusa-firmware|.*based on marlin", re.I), "M84 S0"),
    (re.compile(r"reprapfirmware|smoothieware", re.I), ""),  # idle motors keep their position
)


def stay_awake(firmware: str) -> str | None:
    """The command that keeps idle motors on: a printer that switches them off loses its position without notice.

    Empty for a firmware that needs none. None for an unknown one: what Marlin understands as "keep them on" switches
    them off at once in others, Klipper among them.
    """
    return next((command for name, command in _STAY_AWAKE if name.match(firmware)), None)


def firmware_name(about: str) -> str:
    """The firmware's name in a line of the answer to `FIRMWARE`; empty if the line has none."""
    found = _FIRMWARE.search(about)
    return found[1][:60] if found else ""


_RESEND = re.compile(rb"(?:resend|rs)[: ]\s*N?\s*(\d{1,9})\s*$", re.IGNORECASE)
# After a reset, noise may precede the word.
_START = re.compile(rb"(?:^|.*[^ -~])start$")
# Errors that report a damaged line: the printer requests it again in its next line.
_ASKED_AGAIN = re.compile(rb"error:.*(?:checksum|line number)", re.IGNORECASE)
_FAILED = re.compile(
    rb"error:|alarm:|!!|// klipper state: (?:shutdown|disconnect)|.*unknown command|.*home .*first|(?:resend|rs)\b",
    re.I,
)
_RESTARTED = re.compile(rb"// klipper state: (?:startup|ready)|grbl \d|smoothie$", re.IGNORECASE)
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
    """The printer cannot execute the command, has stopped, or requests a line that cannot be read."""

    text: str


@dataclass(frozen=True, slots=True)
class Restarted:
    """The printer restarted and lost its position."""


@dataclass(frozen=True, slots=True)
class Position:
    """The position that the printer was sent to, and the resolution of its report."""

    x_mm: float
    y_mm: float
    z_mm: float
    step_mm: float


@dataclass(frozen=True, slots=True)
class Said:
    """Any other line: temperatures, a name, a debug line."""

    text: str


Answer = Ok | Busy | Resend | Failed | Restarted | Position | Said


def parse(line: bytes) -> tuple[Answer, ...]:
    """Parse a line without its end: at most one answer, and `Ok` after the text that stands beside it; never raises."""
    line = line.strip()
    if found := _OK.match(line):
        return (*_content(line[found.end() :].strip()), Ok())
    return _content(line)


def _content(line: bytes) -> tuple[Answer, ...]:
    if not line:
        return ()
    text = line.decode("ascii", "replace")
    if position := _position(line):
        return (position,)
    if found := _RESEND.match(line):
        return (Resend(int(found[1])),)
    if _START.match(line) or _RESTARTED.match(line):
        return (Restarted(),)
    if _BUSY.match(line):
        return (Busy(),)
    if _FAILED.match(line) and not _ASKED_AGAIN.match(line):
        return (Failed(text),)
    return (Said(text),)


def _position(line: bytes) -> Position | None:
    """The position, if the line states X, Y and Z, not all in whole millimetres."""
    if not _IS_POSITION.match(line):
        return None
    end = _POSITION_END.search(line)
    axes: dict[bytes, bytes] = {}
    for axis, number in _AXIS.findall(line[: end.start()] if end else line):
        axes.setdefault(axis.upper(), number)
    decimals = max((len(number.partition(b".")[2]) for number in axes.values()), default=0)
    if len(axes) < 3 or not decimals:
        return None
    return Position(float(axes[b"X"]), float(axes[b"Y"]), float(axes[b"Z"]), 10.0**-decimals)


LINE_BYTES_MAX = 512
"""The longest line accepted from a printer."""

_RESENDS_MAX = 3


class Exchange:
    """The host's end of the line, without a clock.

    `failure` is why the printer can no longer be trusted, until `begin_anew`; `has_restarted` stays. `position` is that
    in the printer's answer, `said` its other lines since the command, and `busy` how often it reported that it is busy.
    """

    _SAID_MAX = 32

    def __init__(self) -> None:
        self._number = 0
        self._line = b""
        self._resends = 0
        self._resend_wanted = self._is_damaged = False
        self._buffer = b""
        self.is_done = True
        self.failure = ""
        self.has_restarted = False
        self.position: Position | None = None
        self.said: tuple[str, ...] = ()
        self.busy = 0

    def begin_anew(self) -> bytes:
        """Restart at line 0 and return the bytes to send; call this only while nothing moves."""
        self._number, self.failure, self._buffer = -1, "", b""
        self.is_done = True
        return self.begin(first_number(0))

    def begin(self, command: str) -> bytes:
        """Return the bytes of the next command. Raises RuntimeError while another is not done, or after a failure."""
        if not self.is_done or self.failure:
            raise RuntimeError(f"{command}: {self.failure or 'the printer has not answered the command before it'}")
        self._number += 1
        self._line = numbered(self._number, command)
        self._resends, self._resend_wanted, self._is_damaged = 0, False, False
        self.is_done, self.position, self.said = False, None, ()
        return self._line

    def receive(self, data: bytes) -> bytes:
        """Process received bytes; return the line to send again, or nothing."""
        again = b""
        for line in self._lines(data):
            for answer in parse(line):
                again += self._take(answer)
        return again

    def _lines(self, data: bytes) -> Iterator[bytes]:
        self._buffer += data
        while b"\n" in self._buffer:
            line, _, self._buffer = self._buffer.partition(b"\n")
            yield line
        if len(self._buffer) > LINE_BYTES_MAX:
            self._fail(f"found more than {LINE_BYTES_MAX} bytes without an end of line, expected a printer's answers")
            self._buffer = b""

    def _take(self, answer: Answer) -> bytes:
        match answer:
            case Ok():
                return self._take_ok()
            case Busy():
                self.busy += 1
            case Resend(number):
                self._take_resend(number)
            case Failed(text):
                self._fail(f"it reported {text!r}")
            case Restarted():
                self.has_restarted = True
                self._fail("it restarted and lost its position")
            case Position():
                self.position = answer
            case Said(text):
                self.said = (*self.said, text)[-self._SAID_MAX :]
                self._is_damaged |= bool(_ASKED_AGAIN.match(text.encode()))
        return b""

    def _take_ok(self) -> bytes:
        if self.is_done:
            self._fail("it answered although no command was open")
        elif self._is_damaged:
            self._fail("it reported a damaged line and did not ask for it again")
        elif self._resend_wanted:  # this Ok ends the answer to the damaged line; the resent line gets its own
            self._resend_wanted = False
            return self._line
        else:
            self.is_done = True
        return b""

    def _take_resend(self, number: int) -> None:
        self._resends += 1
        self._is_damaged = False
        if self.is_done or number != self._number:
            self._fail(f"it asked for line {number} again, but the last one was {self._number}")
        elif self._resends > _RESENDS_MAX:
            self._fail(f"it asked for line {number} {self._resends} times: the line is noisy")
        else:
            self._resend_wanted = True

    def _fail(self, text: str) -> None:
        self.failure = self.failure or text
