"""``TOUCH``: the quantities of a touch that a robot requests, the capacity of its line, and the event."""

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
"""Share of the line's capacity for touch events; the rest stays free for answers and other events."""
_BITS_PER_BYTE: Final = 10  # with start and stop bit
_BINARY_MORE: Final = 2  # an L, a byte of COBS and the zero, in place of the LF
_VALUE_BYTES_MAX: Final = 8
_SEQ_MAX: Final = 2**32 - 1


@dataclass(frozen=True, slots=True)
class TouchAsked:
    """The arguments of ``TOUCH ON``: some of `types.touch.QUANTITIES`, and the greatest number of events per second."""

    names: tuple[str, ...]
    rate_hz: int


@dataclass(frozen=True, slots=True)
class TouchSeen:
    """The touch in one frame.

    Attributes
    ----------
    seq, t_ns : int
        Number and capture time of the frame.
    contact : bool
        False once, when the contact ends.
    values : tuple of (str, float or None)
        Name and value of each requested quantity, in the unit of its name; None if unknown.
    """

    seq: int
    t_ns: int
    contact: bool
    values: tuple[tuple[str, float | None], ...]


def parse_touch(args: Sequence[str]) -> TouchAsked | None:
    """Parse the arguments of ``TOUCH``; None is ``OFF``. Raises DecodeError."""
    action, *names = args or ("",)
    if action.upper() == "OFF" and not names:
        return None
    if action.upper() != "ON":
        raise DecodeError(f"found {' '.join(args)[:40]!r}, expected ON or OFF")
    rate_hz = RATE_DEFAULT_HZ
    if names and names[-1][0].isdigit():
        text = names.pop()
        if not text.isdigit() or not 1 <= int(text) <= RATE_MAX_HZ:
            raise DecodeError(f"found the RATE {text[:16]}, expected a whole number of Hz from 1 to {RATE_MAX_HZ}")
        rate_hz = int(text)
    unknown = next((name for name in names if name not in QUANTITIES), None)
    if unknown is not None:
        raise DecodeError(f"found {unknown[:20]!r}, expected one of {' '.join(QUANTITIES)}")
    if not 1 <= len(set(names)) == len(names) <= NAMES_MAX:
        raise DecodeError(f"found {len(names)} names, expected 1 to {NAMES_MAX} different names")
    return TouchAsked(tuple(names), rate_hz)


def touch_text(seen: TouchSeen) -> str:
    """The event's line; at the end of a contact, it has ``contact=0`` and no values."""
    end = "" if seen.contact else " contact=0"
    values = "".join(f" {name}={_value_text(value)}" for name, value in seen.values)
    return f"EVT TOUCH {seen.seq} {seen.t_ns}{end}{values}"


def too_slow(asked: TouchAsked, baud: int) -> Reason | None:
    """Why a line of `baud` bits/s cannot carry the events at their longest; None if it can."""
    longest_bytes, most_bytes_s = event_bytes_max(asked.names), SHARE * baud / _BITS_PER_BYTE
    if asked.rate_hz * longest_bytes <= most_bytes_s:
        return None
    found = f"found {asked.rate_hz * longest_bytes} bytes/s ({asked.rate_hz} events/s of up to {longest_bytes} bytes)"
    expected = f"expected at most {most_bytes_s:.0f} bytes/s ({100 * SHARE:g} % of {baud} baud)"
    rate_hz = int(most_bytes_s // longest_bytes)
    instead = f"a RATE of at most {rate_hz}, " if rate_hz else ""
    return Reason(ReasonCode.LINE_TOO_SLOW, f"{found}, {expected}; use {instead}fewer names or a faster line")


def event_bytes_max(names: Sequence[str]) -> int:
    """The greatest length in bytes of an event of these quantities, with its checksum, in either mode."""
    ends, touches = (
        len(seal(touch_text(TouchSeen(_SEQ_MAX, T_NS_MAX, contact, tuple((name, None) for name in names)))))
        for contact in (False, True)
    )
    return max(ends, touches + len(names) * (_VALUE_BYTES_MAX - 1)) + _BINARY_MORE


def _value_text(value: float | None) -> str:
    """Format with three decimals, a large number with one; ``-`` if unknown or larger than any touch."""
    if value is None or not math.isfinite(value):
        return "-"
    return next((text for n in (3, 1) if len(text := f"{value:.{n}f}") <= _VALUE_BYTES_MAX), "-")
