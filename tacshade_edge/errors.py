"""Every exception that this package raises on purpose.

::

    TacshadeError
    ├── ConfigError   the user's settings, calibration or arguments are wrong: one line, exit 78
    ├── DeviceError   the outside failed (camera, broker, disk): back off and retry; exit 1 in a one-shot command
    └── DecodeError   bytes or a file could not be understood: count it, go on with the next

Anything else that is raised is a defect: it ends the process, and systemd restarts it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from .reasons import Reason, ReasonCode


class TacshadeError(Exception):
    """Base of the three; only those are raised.

    Parameters
    ----------
    text : str
        One line: what, where, and what was expected.
    code : ReasonCode, optional
        For programs; by default the one of the class.
    """

    _code: ClassVar[ReasonCode]

    def __init__(self, text: str, *, code: ReasonCode | None = None) -> None:
        super().__init__(text)
        self.code = code or self._code

    @property
    def reason(self) -> Reason:
        """Code and text."""
        return Reason(self.code, str(self))


class ConfigError(TacshadeError):
    """Settings, calibration or arguments that cannot work as they are (exit 78).

    Parameters
    ----------
    text : str
    code : ReasonCode, optional
    others : sequence of str
        What else is wrong with the same file, a line each.
    """

    _code = ReasonCode.CONFIG

    def __init__(self, text: str, *, code: ReasonCode | None = None, others: Sequence[str] = ()) -> None:
        super().__init__(text, code=code)
        self.others = tuple(others)


class DeviceError(TacshadeError):
    """A camera, line, broker or disk that failed; it may come back."""

    _code = ReasonCode.DEVICE


class DecodeError(TacshadeError):
    """Bytes or a file that do not follow their format."""

    _code = ReasonCode.DECODE
