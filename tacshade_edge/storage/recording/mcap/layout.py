"""The layout of an MCAP file: record heads, and the lengths that a record's head and its fields state."""

from __future__ import annotations

import os
import struct
from enum import IntEnum
from typing import BinaryIO, Final

MAGIC: Final = b"\x89MCAP0\r\n"
HEAD: Final = struct.Struct("<BQ")  # kind, length
_WINDOW_BYTES: Final = 1 << 14
_LATER_FIELDS_BYTES: Final = 64
"""Most that later format versions may add to a record; a longer one is another kind with a changed first byte."""


class Kind(IntEnum):
    """The first byte of a record; values from 0x80 on are private to their writer."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


# Number of bytes, or the format of the number that states how many bytes follow it.
_SHORT, _LONG = "<I", "<Q"
_FIELDS: Final[dict[int, tuple[int | str, ...]]] = {
    Kind.HEADER: (_SHORT, _SHORT),
    Kind.FOOTER: (20,),
    Kind.SCHEMA: (2, _SHORT, _SHORT, _SHORT),
    Kind.CHANNEL: (4, _SHORT, _SHORT, _SHORT),
    Kind.MESSAGE: (22,),
    Kind.CHUNK: (28, _SHORT, _LONG),
    Kind.MESSAGE_INDEX: (2, _SHORT),
    Kind.CHUNK_INDEX: (32, _SHORT, 8, _SHORT, 16),
    Kind.ATTACHMENT: (16, _SHORT, _SHORT, _LONG, 4),
    Kind.ATTACHMENT_INDEX: (40, _SHORT, _SHORT),
    Kind.STATISTICS: (42, _SHORT),
    Kind.METADATA: (_SHORT, _SHORT),
    Kind.METADATA_INDEX: (16, _SHORT),
    Kind.SUMMARY_OFFSET: (17,),
    Kind.DATA_END: (4,),
}


class ByteFile:
    """Random access to the bytes of a file, up to its size when it was opened.

    Parameters
    ----------
    stream : BinaryIO
        Stays open; its position is not used.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.size = os.fstat(stream.fileno()).st_size
        self._window, self._begin = b"", 0

    def at(self, place: int, count: int) -> bytes:
        """Read a few bytes, fewer at the end of the file, and buffer those after them."""
        if place < self._begin or place + count > self._begin + len(self._window):
            self._window, self._begin = self.block(place, max(count, _WINDOW_BYTES)), place
        return self._window[place - self._begin : place - self._begin + count]

    def block(self, place: int, count: int) -> bytes:
        """Read many bytes, fewer at the end of the file."""
        left = max(0, min(count, self.size - place))
        parts = []
        while left and (part := os.pread(self._stream.fileno(), left, place)):
            parts.append(part)
            left, place = left - len(part), place + len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def head(self, place: int) -> tuple[int, int] | None:
        """The kind and length of the record at `place`; None if the file is too short for it."""
        head = self.at(place, HEAD.size)
        if len(head) < HEAD.size:
            return None
        kind, length = HEAD.unpack(head)
        return (kind, length) if place + HEAD.size + length <= self.size else None

    def begins_record(self, place: int) -> bool:
        """Whether a record of a known kind may begin at `place`, or the file ends there."""
        if place >= self.size or self.at(place, len(MAGIC)) == MAGIC:
            return True
        head = self.head(place)
        return head is not None and head[0] in _FIELDS

    def is_sound(self, place: int) -> bool:
        """Whether the record at `place` is as long as its own fields say.

        After a message, or a record with unknown additional fields, something like a record must follow.
        """
        if (head := self.head(place)) is None:
            return False
        kind, length = head
        stated = self._stated_length(kind, place + HEAD.size, length)
        if stated is None:
            return False
        if kind != Kind.MESSAGE and stated == length:
            return True
        is_possible = kind == Kind.MESSAGE or length - stated <= _LATER_FIELDS_BYTES
        return is_possible and self.begins_record(place + HEAD.size + length)

    def _stated_length(self, kind: int, place: int, length: int) -> int | None:
        """The length according to the record's own fields; None if it exceeds the record."""
        stated = 0
        for field in _FIELDS.get(kind, (length + 1,)):
            if isinstance(field, int):
                stated += field
            else:
                size = struct.calcsize(field)
                number = self.at(place + stated, size)
                stated += size + (struct.unpack(field, number)[0] if len(number) == size else length)
            if stated > length:
                return None
        return stated
