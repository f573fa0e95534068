"""What seems wrong with numbers, as values, and the sentence for each, in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Final


class SuspicionCode(Enum):
    """Everything that numbers may be suspected of."""

    # Times.
    STEPS_TOO_SHORT = auto()
    TIME_ROUNDED = auto()
    TIME_FRACTION = auto()
    TABLE_EDITED = auto()
    CLOCK_RATE = auto()
    CLOCK_COUNTS_DOWN = auto()
    CLOCK_STANDS = auto()


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A code, what its sentence says by names with units, and whether the numbers cannot be as they
    stand (else they might).
    """

    code: SuspicionCode
    values: Mapping[str, object] = field(default_factory=dict)
    impossible: bool = False

    def __str__(self) -> str:
        values = {
            name: f" in {value}?" if name == "unit" else value
            for name, value in self.values.items()
            if value is not None
        }
        values.setdefault("unit", " in another unit?")
        return SUSPICION_SENTENCES[self.code].format(**values)


def suspicion(code: SuspicionCode, *, impossible: bool = False, **values: object) -> Suspicion:
    """A suspicion with the values of its sentence."""
    return Suspicion(code, values, impossible)


SUSPICION_SENTENCES: Final[Mapping[SuspicionCode, str]] = {
    SuspicionCode.STEPS_TOO_SHORT: (
        "t_ns: found frames {step_ns:g} ns apart, expected at least {least_ns} ns: "
        "are the times{unit}"
    ),
    SuspicionCode.TIME_ROUNDED: (
        "t_ns: found {found}, expected a whole number of nanoseconds: has a spreadsheet rounded it?"
    ),
    SuspicionCode.TIME_FRACTION: (
        "t_ns: found {found}, expected a whole number of nanoseconds: are the times in s?"
    ),
    SuspicionCode.TABLE_EDITED: (
        "no line has its checksum: was the table edited? without its column crc32 it is read as "
        "it stands"
    ),
    SuspicionCode.CLOCK_RATE: (
        "found the robot's times to pass {rate:.3g} times as fast as time, expected ns: "
        "are they{unit}"
    ),
    SuspicionCode.CLOCK_COUNTS_DOWN: (
        "found the robot's times to go backwards, expected ns that increase"
    ),
    SuspicionCode.CLOCK_STANDS: (
        "found the robot's time to stand still while it sends, expected ns that increase"
    ),
}
"""The sentence of each; `{unit}` ends with a question mark."""
