"""The output to the robot: sealed lines, framed for the current mode."""

from __future__ import annotations

from tacshade_edge.protocol.serial import cobs
from tacshade_edge.protocol.serial.answers import error_text, printable, seq_text
from tacshade_edge.protocol.serial.counts import LinkCounts
from tacshade_edge.protocol.serial.framing import Framing
from tacshade_edge.protocol.serial.line import seal
from tacshade_edge.reasons import Reason


class Output:
    """Keeps lines until the port takes them.

    Parameters
    ----------
    framing : Framing
        Provides the mode of the lines.
    counts : LinkCounts
    """

    def __init__(self, framing: Framing, counts: LinkCounts) -> None:
        self._framing, self._counts = framing, counts
        self._waiting = bytearray()

    def accept(self, seq: int | None, text: str) -> None:
        """Answer ``OK``."""
        self.send(printable(f"OK {seq_text(seq)} {text}"))

    def refuse(self, seq: int | None, reason: Reason) -> None:
        """Answer ``ERR`` to a line that was not passed on as a command."""
        self._counts.refused += 1
        self.send(printable(f"ERR {seq_text(seq)} {error_text(reason)}"))

    def send(self, text: str) -> None:
        """Seal a line and keep it."""
        line = seal(text)
        self._waiting += line if self._framing.mode == "ASCII" else cobs.encode(b"L" + line[:-1]) + b"\0"

    def take(self) -> bytes:
        """Return the bytes to write to the port and forget them."""
        output = bytes(self._waiting)
        self._waiting.clear()
        return output
