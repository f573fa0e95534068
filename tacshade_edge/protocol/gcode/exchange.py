"""Exchange one command at a time with a printer, however the answer's bytes are split."""

from __future__ import annotations

from collections.abc import Iterator

from tacshade_edge.protocol.gcode.answers import Answer, Busy, Failed, Ok, Position, Resend, Restarted, Said, parse
from tacshade_edge.protocol.gcode.commands import first_number, numbered

LINE_BYTES_MAX = 512
"""The longest line accepted from a printer."""

_RESENDS_MAX = 3


class Exchange:
    """The host's end of the line, without a clock.

    Attributes
    ----------
    is_done : bool
        Whether the printer has answered the command.
    failure : str
        Why the printer can no longer be trusted; empty while it can. It persists until `begin_anew`.
    has_restarted : bool
        Whether the printer has ever restarted; `begin_anew` does not clear it.
    position : Position or None
        The position in the printer's answer.
    said : tuple of str
        The other lines since the command, at most `_SAID_MAX`.
    busy : int
        How often the printer reported that it is busy.
    """

    _SAID_MAX = 32

    def __init__(self) -> None:
        self._number = 0
        self._line = b""
        self._resends = 0
        self._resend_wanted = False
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
        self._resends, self._resend_wanted = 0, False
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
        return b""

    def _take_ok(self) -> bytes:
        if self.is_done:
            self._fail("it answered although no command was open")
        elif self._resend_wanted:  # this Ok ends the answer to the damaged line; the resent line gets its own
            self._resend_wanted = False
            return self._line
        else:
            self.is_done = True
        return b""

    def _take_resend(self, number: int) -> None:
        self._resends += 1
        if self.is_done or number != self._number:
            self._fail(f"it asked for line {number} again, but the last one was {self._number}")
        elif self._resends > _RESENDS_MAX:
            self._fail(f"it asked for line {number} {self._resends} times: the line is noisy")
        else:
            self._resend_wanted = True

    def _fail(self, text: str) -> None:
        self.failure = self.failure or text
