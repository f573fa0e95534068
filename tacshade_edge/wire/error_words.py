"""The words of refusals on the robot's line, and at the beginning of an error of ``res/stitch``."""

from __future__ import annotations

from typing import Final

from tacshade_edge.reasons import ReasonCode

# To a robot these are one case: a person has to look. The codes tell the person more.
_FAILED: Final = ("config", "device", "decode", "disk", "in_use", "disk_full")
ERROR_WORDS: Final[dict[ReasonCode, str]] = {
    **{ReasonCode(code): "FAILED" for code in _FAILED},
    ReasonCode.UNKNOWN_VERB: "VERB",
    ReasonCode.BAD_ARGUMENTS: "ARGS",
    ReasonCode.BAD_CHECKSUM: "CRC",
    ReasonCode.BAD_SYNTAX: "SYNTAX",
    ReasonCode.OTHER_VERSION: "VERSION",
    ReasonCode.NUMBER_REUSED: "REUSED",
    ReasonCode.NUMBER_STALE: "STALE",
    ReasonCode.BUSY: "BUSY",
    ReasonCode.TIMEOUT: "TIMEOUT",
    ReasonCode.UNAVAILABLE: "UNAVAILABLE",
    ReasonCode.NOT_CALIBRATED: "UNCALIBRATED",
    ReasonCode.FRAME_INVALID: "INVALID",
    ReasonCode.NO_SESSION: "NOSESSION",
    ReasonCode.BAD_NAME: "NAME",
    ReasonCode.NAME_TAKEN: "EXISTS",
    ReasonCode.NO_FRAME: "NOFRAME",
    ReasonCode.NO_CONTACT: "NOCONTACT",
    ReasonCode.NO_POSE: "NOPOSE",
    ReasonCode.MAP_FULL: "FULL",
    ReasonCode.NO_PRESS: "EMPTY",
}
"""The word of each code on the serial line, and at the beginning of an error of ``res/stitch``."""
# A code without a word is newer than the line's words, which are a promise.
OTHERWISE: Final = "REFUSED"


def error_word(code: ReasonCode) -> str:
    """The code's word of a refusal."""
    return ERROR_WORDS.get(code, OTHERWISE)
