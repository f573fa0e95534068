"""MCAP files byte by byte: hostile and damaged ones that no writer writes."""

from __future__ import annotations

import struct
import zlib

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END, FOOTER = 3, 4, 5, 6, 15, 2
_HEAD = struct.Struct("<BQ")


def record(kind: int, body: bytes) -> bytes:
    """A record: head and body."""
    return _HEAD.pack(kind, len(body)) + body


def text(value: str) -> bytes:
    """A string as records encode it."""
    data = value.encode()
    return struct.pack("<I", len(data)) + data


def message(payload: bytes, t_ns: int, channel: int = 1) -> bytes:
    """A message with this time."""
    return record(MESSAGE, struct.pack("<HIQQ", channel, 0, t_ns, t_ns) + payload)


def described(schema: str = "foxglove.CompressedImage", topic: str = "/cam") -> bytes:
    """The schema and the channel with number 1."""
    return record(
        SCHEMA, struct.pack("<H", 1) + text(schema) + text("protobuf") + bytes(4)
    ) + record(CHANNEL, struct.pack("<HH", 1, 1) + text(topic) + text("protobuf") + bytes(4))


def chunk(packed: bytes, compression: str, size: int, crc: int = 0) -> bytes:
    """A chunk that declares the given compression, size and CRC."""
    return record(
        CHUNK,
        struct.pack("<QQQI", 0, 1, size, crc)
        + text(compression)
        + struct.pack("<Q", len(packed))
        + packed,
    )


def file_of(data: bytes, summary: bytes = b"") -> bytes:
    """A whole file of these records."""
    begun = MAGIC + record(1, bytes(8)) + data + record(DATA_END, bytes(4))
    foot = struct.pack("<QQ", len(begun) if summary else 0, 0)
    crc = zlib.crc32(summary + _HEAD.pack(FOOTER, 20) + foot) if summary else 0
    return begun + summary + record(FOOTER, foot + struct.pack("<I", crc)) + MAGIC


def record_starts(content: bytes) -> list[int]:
    """Offsets of the records outside chunks."""
    starts, at = [], len(MAGIC)
    while at < len(content) - len(MAGIC):
        starts.append(at)
        at += _HEAD.size + _HEAD.unpack_from(content, at)[1]
    return starts


def flipped(content: bytes, byte: int, bit: int) -> bytes:
    """The content with one bit flipped."""
    changed = bytearray(content)
    changed[byte] ^= 1 << bit
    return bytes(changed)
