"""Every exception that this package raises on purpose.

Any other one is a defect, which ends the process.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from .reasons import Reason, ReasonCode


class TacshadeError(Exception):
    """The base class: one line of text, and a code for programs, by default the class's own."""

    # Of each class, so that no error is without a code, whoever raises it.
    _code: ClassVar[ReasonCode]

    def __init__(self, text: str, *, code: ReasonCode | None = None) -> None:
        super().__init__(text)
        self.code = code or self._code

    @property
    def reason(self) -> Reason:
        """The error's code and text."""
        return Reason(self.code, str(self))


class ConfigError(TacshadeError):
    """Settings, a calibration or arguments that cannot work as they are (exit 78).

    `others`: further mistakes in the same file, one line each;
    a line counts those after the first 50.
    """

    _code = ReasonCode.CONFIG
    # A table of 10 000 bad rows must not fill a terminal or a journal.
    _OTHERS_MAX: ClassVar[int] = 50

    def __init__(
        self, text: str, *, code: ReasonCode | None = None, others: Sequence[str] = ()
    ) -> None:
        super().__init__(text, code=code)
        self.others = tuple(others[: self._OTHERS_MAX])
        if more := len(others) - len(self.others):
            # Counted, because a person has to know that fixing these is not all.
            self.others += (f"and {more} more mistakes",)


class DeviceError(TacshadeError):
    """Something outside (camera, robot, broker, disk) failed and may come back: retry;
    exit 1 in a one-shot command.
    """

    _code = ReasonCode.DEVICE


class DecodeError(TacshadeError):
    """Bytes or a file that do not follow their format: count it and continue with the next."""

    _code = ReasonCode.DECODE
