"""Why something is not as it should be: a code for programs, from one enumeration, and a text for people.

Programs decide by the code alone, so a text may be worded anew at any time.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class ReasonCode(StrEnum):
    """Every reason that is told: in ``summary.json``, over MQTT and on the serial line."""

    # A frame.
    SIZE = "size"


@dataclass(frozen=True, slots=True)
class Reason:
    """One reason.

    Attributes
    ----------
    code : ReasonCode
    text : str
        One line.
    """

    code: ReasonCode
    text: str

    def __str__(self) -> str:
        return self.text
