"""Assemble received bytes, however they are split, into whole lines (ASCII) and COBS frames (BIN)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from tacshade_edge.protocol.serial.counts import LinkCounts
from tacshade_edge.protocol.serial.line import LINE_BYTES_MAX
from tacshade_edge.protocol.serial.modes import POSE_FRAME_BYTES, Mode, find_hello, first_pose_frame

FRAME_BYTES_MAX: Final = LINE_BYTES_MAX + 3  # COBS of "L" and the longest line
_LINE_END = re.compile(rb"[\r\n]")


@dataclass(frozen=True, slots=True)
class Unit:
    """A whole line without its end, or a frame without its zero."""

    raw: bytes
    is_line: bool


class Framing:
    """The received bytes that are not a whole line or frame yet.

    Parameters
    ----------
    counts : LinkCounts
        Counts the garbage.

    Attributes
    ----------
    mode : str
        ``ASCII`` or ``BIN``: the mode of the next bytes.
    """

    def __init__(self, counts: LinkCounts) -> None:
        self.mode: Mode = "ASCII"
        self._counts = counts
        self._buffer = b""
        self._skipping = False  # until the next end of a line or frame
        self._since_zero = b""  # in ASCII: bytes that may turn out to be a binary pose

    @property
    def buffered_bytes(self) -> int:
        """Number of bytes that wait for the rest of their line or frame."""
        return len(self._buffer)

    def feed(self, data: bytes) -> None:
        """Append received bytes."""
        if self.mode == "ASCII":
            self._since_zero += data
        self._buffer += data

    def next_unit(self) -> Unit | None:
        """Take the next whole line or frame, or None; in response to it, the caller may `switch` the mode."""
        if self.mode == "ASCII":
            if (line := self._next_line()) is not None:
                return line
            if not self._detect_binary():
                return None
        return self._next_frame()

    def switch(self, mode: Mode) -> None:
        """Read the following bytes in `mode`."""
        if mode != self.mode:
            self.mode, self._since_zero = mode, b""

    def clear(self) -> None:
        """Discard a partial line, whose rest is lost."""
        self._counts.discard(len(self._buffer))
        self._buffer = self._since_zero = b""
        self._skipping = False

    def _next_line(self) -> Unit | None:
        while (end := _LINE_END.search(self._buffer)) is not None:
            raw, self._buffer = self._buffer[: end.start()], self._buffer[end.end() :]
            if self._is_whole(raw):
                return Unit(raw, is_line=True)
        if len(self._buffer) >= LINE_BYTES_MAX:
            self._skip()
        return None

    def _next_frame(self) -> Unit | None:
        while True:
            raw, zero, rest = self._buffer.partition(b"\0")
            if (hello := find_hello(raw)) is not None:
                self._counts.discard(hello.start())
                self._skipping = False
                self._buffer = self._buffer[hello.end() :]
                self.switch("ASCII")
                return Unit(hello[1], is_line=True)
            if not zero:
                if len(raw) > FRAME_BYTES_MAX:
                    self._skip(keep=LINE_BYTES_MAX)
                return None
            self._buffer = rest
            if self._is_whole(raw):
                return Unit(raw, is_line=False)

    def _is_whole(self, raw: bytes) -> bool:
        """Whether the line or frame that ends here has its beginning too."""
        if self._skipping:
            self._skipping = False
            self._counts.garbage_bytes += len(raw)
            return False
        return bool(raw)

    def _skip(self, keep: int = 0) -> None:
        """Skip an overlong line or frame up to its end; keep its last `keep` bytes to search."""
        if not self._skipping:
            self._counts.garbage += 1
        self._skipping = True
        self._counts.garbage_bytes += len(self._buffer) - keep
        self._buffer = self._buffer[len(self._buffer) - keep :]

    def _detect_binary(self) -> bool:
        """Switch to BIN if a whole binary pose proves that the robot uses it."""
        *frames, tail = self._since_zero.split(b"\0")
        self._since_zero = tail[-(POSE_FRAME_BYTES + 1) :]
        if (first := first_pose_frame(frames)) is None:
            return False
        self._counts.discard(len(self._buffer))
        self._skipping = False
        self._buffer = b"\0".join([*frames[first:], tail])
        self.switch("BIN")
        return True
