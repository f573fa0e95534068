"""Assemble received bytes, however they are split, into whole lines (ASCII) and COBS frames (BIN).

Consistent overhead byte stuffing (Cheshire and Baker, IEEE/ACM Transactions on Networking 7, 1999)
encodes any bytes without a zero, so that a zero can end a frame. The mode is detected from the
bytes, so that neither side waits forever when only one has changed its mode.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Literal

from tacshade_edge.errors import DecodeError
from tacshade_edge.robot.line import LINE_BYTES_MAX
from tacshade_edge.robot.pose import POSE_BYTES, decode_pose

Mode = Literal["ASCII", "BIN"]

FRAME_BYTES_MAX: Final = LINE_BYTES_MAX + 3  # COBS of "L" and the longest line
_FULL_BLOCK: Final = 255  # this code alone stands for no zero
_BLOCK: Final = _FULL_BLOCK - 1  # bytes after it
_POSE_FRAME_BYTES: Final = POSE_BYTES + 1  # COBS of a pose, without its zero
_LINE_END = re.compile(rb"[\r\n]")
# A HELLO among frames, but not inside one, where an L precedes the line; by chance 2^-56 per byte.
_HELLO = re.compile(rb"((?:(?<!L)#\d{1,5} +|(?<![L ]))HELLO 1[ -~]*)[\r\n]")


def cobs_encode(data: bytes) -> bytes:
    """Encode `data` without a zero: one byte longer,
    plus one for every 254 bytes without a zero.
    """
    out = bytearray()
    runs = data.split(b"\0")
    for number, run in enumerate(runs, 1):
        at = 0
        while len(run) - at >= _BLOCK:
            out.append(_FULL_BLOCK)
            out += run[at : at + _BLOCK]
            at += _BLOCK
        # A full block at the very end needs no further code.
        if at == 0 or at < len(run) or number < len(runs):
            out.append(len(run) - at + 1)
            out += run[at:]
    return bytes(out)


def cobs_decode(data: bytes) -> bytes:
    """Decode the output of `cobs_encode`.

    Raises DecodeError for a zero, or a block longer than the data.
    """
    out = bytearray()
    at, end = 0, len(data)
    if b"\0" in data:
        raise DecodeError("COBS: found a zero byte inside a frame, expected none")
    while at < end:
        code = data[at]
        if at + code > end:
            raise DecodeError(
                f"COBS: found {end - at - 1} bytes in the last block, expected {code - 1}"
            )
        out += data[at + 1 : at + code]
        at += code
        if code != _FULL_BLOCK and at < end:
            out.append(0)
    return bytes(out)


@dataclass(slots=True)
class LinkCounts:
    """Counts since the start.

    Every numbered pose between two that arrived is in `poses` or `poses_lost`.
    """

    bytes: int = 0
    lines: int = 0
    commands: int = 0  # passed on, each once
    repeats: int = 0  # answered from the cache, or still in progress
    refused: int = 0  # answered with ERR, not passed on
    echoes: int = 0  # our own lines, returned
    poses: int = 0
    poses_lost: int = 0  # by their numbers
    poses_repeated: int = 0
    poses_bad: int = 0  # undamaged, but not a valid pose
    damaged: int = 0  # lines and frames with a wrong checksum
    garbage: int = 0  # runs of bytes that are neither line nor frame
    garbage_bytes: int = 0

    def discard(self, length: int) -> None:
        """Count a run of garbage, if there is any."""
        if length:
            self.garbage += 1
            self.garbage_bytes += length


@dataclass(frozen=True, slots=True)
class Unit:
    """A whole line without its end, or a frame without its zero."""

    raw: bytes
    is_line: bool


class Framing:
    """The received bytes that are not a whole line or frame yet, and the mode of the next ones;
    counts the garbage.
    """

    def __init__(self, counts: LinkCounts) -> None:
        self.mode: Mode = "ASCII"
        self._counts = counts
        self._buffer = b""
        self._skipping = False  # until the next end of a line or frame
        self._since_zero = b""  # in ASCII: bytes that may turn out to be a binary pose

    def feed(self, data: bytes) -> None:
        """Append received bytes."""
        if self.mode == "ASCII":
            # Beside the buffer: a byte of a binary pose may look like the end of a line, and then
            # the line takes the pose's beginning out of the buffer.
            self._since_zero += data
        self._buffer += data

    def next_unit(self) -> Unit | None:
        """Take the next whole line or frame, or None;
        in response to it, the caller may `switch` the mode.
        """
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
            # Before a zero is waited for: a robot that restarted speaks ASCII, which has none.
            if b"HELLO 1" in raw and (hello := _HELLO.search(raw)) is not None:
                self._counts.discard(hello.start())
                self._skipping = False
                self._buffer = self._buffer[hello.end() :]
                self.switch("ASCII")
                return Unit(hello[1], is_line=True)
            if not zero:
                if len(raw) > FRAME_BYTES_MAX:
                    # What is kept may hold the beginning of a HELLO.
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
        """Switch to BIN if a whole binary pose proves that the robot uses it:
        the daemon restarted, the robot not.
        """
        *frames, tail = self._since_zero.split(b"\0")
        # The tail may be the beginning of a pose that is not whole yet.
        self._since_zero = tail[-(_POSE_FRAME_BYTES + 1) :]
        first = next((at for at, frame in enumerate(frames) if _is_pose(frame)), None)
        if first is None:
            return False
        self._counts.discard(len(self._buffer))
        self._skipping = False
        # The first pose proves the mode, so it is read again as a frame and not lost.
        self._buffer = b"\0".join([*frames[first:], tail])
        self.switch("BIN")
        return True


def _is_pose(frame: bytes) -> bool:
    try:
        decode_pose(cobs_decode(frame) if len(frame) == _POSE_FRAME_BYTES else b"")
    except DecodeError:
        return False
    return True
