"""``TOUCH``: which quantities of a touch a robot asks for, what its line can carry of them, and the event."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.serial.line import seal
from tacshade_edge.protocol.serial.pose import T_NS_MAX
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import QUANTITIES

NAMES_MAX: Final = 6
RATE_DEFAULT_HZ: Final = 60
RATE_MAX_HZ: Final = 1000
SHARE: Final = 0.9
"""Of the line towards the robot; the rest stays free for answers and other events."""
_BITS_PER_BYTE: Final = 10  # with start and stop bit
_BINARY_MORE: Final = 2  # an L, a byte of COBS and the zero, in place of the LF
_VALUE_BYTES_MAX: Final = 8
_SEQ_MAX: Final = 2**32 - 1


@dataclass(frozen=True, slots=True)
class TouchAsked:
    """Of ``TOUCH ON``: some of `types.touch.QUANTITIES`, and at most how many events a second."""

    names: tuple[str, ...]
    rate_hz: int


@dataclass(frozen=True, slots=True)
class TouchSeen:
    """The touch that a frame shows.

    Attributes
    ----------
    seq, t_ns : int
        The frame's.
    contact : bool
        False once, when it ends.
    values : tuple of (str, float or None)
        Of each quantity that was asked for, in the unit of its name; None where it is not known.
    """

    seq: int
    t_ns: int
    contact: bool
    values: tuple[tuple[str, float | None], ...]


def parse_touch(args: Sequence[str]) -> TouchAsked | None:
    """Understand the arguments of ``TOUCH``; None is ``OFF``. Raises DecodeError."""
    action, *names = args or ("",)
    if action.upper() == "OFF" and not names:
        return None
    if action.upper() != "ON":
        raise DecodeError(f"found {' '.join(args)[:40]!r}, expected ON or OFF")
    rate_hz = RATE_DEFAULT_HZ
    if names and names[-1][0].isdigit():
        text = names.pop()
        if not text.isdigit() or not 1 <= int(text) <= RATE_MAX_HZ:
            raise DecodeError(f"found the RATE {text[:16]}, expected whole Hz from 1 to {RATE_MAX_HZ}")
        rate_hz = int(text)
    unknown = next((name for name in names if name not in QUANTITIES), None)
    if unknown is not None:
        raise DecodeError(f"found {unknown[:20]!r}, expected one of {' '.join(QUANTITIES)}")
    if not 1 <= len(set(names)) == len(names) <= NAMES_MAX:
        raise DecodeError(f"found {len(names)} names, expected 1 to {NAMES_MAX}, each once")
    return TouchAsked(tuple(names), rate_hz)


def touch_text(seen: TouchSeen) -> str:
    """The event's line; at the end of a contact it has ``contact=0`` and no value."""
    end = "" if seen.contact else " contact=0"
    values = "".join(f" {name}={_value_text(value)}" for name, value in seen.values)
    return f"EVT TOUCH {seen.seq} {seen.t_ns}{end}{values}"


def too_slow(asked: TouchAsked, baud: int) -> Reason | None:
    """Why a line of so many bits a second cannot carry the events, at their longest; None where it can."""
    longest_bytes, most_bytes_s = event_bytes_max(asked.names), SHARE * baud / _BITS_PER_BYTE
    if asked.rate_hz * longest_bytes <= most_bytes_s:
        return None
    found = f"found {asked.rate_hz} events a second of up to {longest_bytes} bytes"
    expected = f"expected at most {most_bytes_s:.0f} bytes/s, {100 * SHARE:g} % of {baud} baud"
    rate_hz = int(most_bytes_s // longest_bytes)
    instead = f"a RATE of at most {rate_hz}, " if rate_hz else ""
    return Reason(ReasonCode.LINE_TOO_SLOW, f"{found}, {expected}: use {instead}fewer names or a faster line")


def event_bytes_max(names: Sequence[str]) -> int:
    """How long an event of these quantities can be, with its checksum, in either mode."""
    ends, touches = (
        len(seal(touch_text(TouchSeen(_SEQ_MAX, T_NS_MAX, contact, tuple((name, None) for name in names)))))
        for contact in (False, True)
    )
    return max(ends, touches + len(names) * (_VALUE_BYTES_MAX - 1)) + _BINARY_MORE


def _value_text(value: float | None) -> str:
    """Three decimals, one of a great number; ``-`` where it is not known, or greater than any touch."""
    if value is None or not math.isfinite(value):
        return "-"
    return next((text for n in (3, 1) if len(text := f"{value:.{n}f}") <= _VALUE_BYTES_MAX), "-")
