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
    NO_DISC = "no_disc"
    SATURATED = "saturated"
    BLACK = "black"
    NO_CONTRAST = "no_contrast"
    NOISE = "noise"
    LIGHT = "light"
    TORN = "torn"
    SURROUND = "surround"
    GLARE = "glare"
    LIGHT_DRIFT = "light_drift"
    CAMERA_SHIFT = "camera_shift"
    NO_USABLE_FRAME = "no_usable_frame"


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


def text_of(reason: Reason | None) -> str:
    """Its text; empty without one."""
    return "" if reason is None else reason.text


def code_of(reason: Reason | None) -> str:
    """Its code; empty without one."""
    return "" if reason is None else reason.code.value
