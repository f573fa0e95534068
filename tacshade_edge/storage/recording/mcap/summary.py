"""The summary at the end of an MCAP file: channels, counts, and the places of its chunks."""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from tacshade_edge.storage.recording.mcap.layout import HEAD, MAGIC, ByteFile, Kind

SUMMARY_BYTES_MAX: Final = 16 << 20
"""Enough for an index of 100 000 chunks, or 500 GB in chunks of the usual size."""
NAME_BYTES_MAX: Final = 4096
_FOOTER: Final = struct.Struct("<QQI")  # places of the summary and of its offsets, CRC-32
_FOOTER_BYTES: Final = HEAD.size + _FOOTER.size + len(MAGIC)
_COUNT: Final = struct.Struct("<HQ")


@dataclass(frozen=True, slots=True)
class SchemaName:
    """A schema without its text."""

    id: int
    name: str


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic; `metadata` comes from its writer."""

    id: int
    schema_id: int
    topic: str
    encoding: str
    metadata: dict[str, str]


@dataclass(slots=True)
class Summary:
    """The summary of one file.

    Attributes
    ----------
    begin : int
        Its first byte, at the end of the data section.
    schemas : dict of int to SchemaName
    channels : dict of int to Channel
    counts : dict of int to int
        Number of messages in each channel; empty if the file does not state it.
    span_ns : tuple of int or None
        Times of the first and the last message.
    starts : array of int
        First bytes of chunks and attachments, sorted.
    in_chunks : bool
        The file has chunks.
    """

    begin: int
    schemas: dict[int, SchemaName] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    span_ns: tuple[int, int] | None = None
    starts: array[int] = field(default_factory=lambda: array("Q"))
    in_chunks: bool = False


def read_summary(file: ByteFile) -> tuple[Summary | None, str]:
    """The summary of a whole file; None and a reason if it is unusable, None and an empty text if there is none."""
    footer_at = file.size - _FOOTER_BYTES
    if footer_at < len(MAGIC) or file.block(file.size - len(MAGIC), len(MAGIC)) != MAGIC:
        return None, ""
    if file.head(footer_at) != (Kind.FOOTER, _FOOTER.size):
        return None, "ignoring the damaged index at its end"
    begin, _, crc = _FOOTER.unpack(file.at(footer_at + HEAD.size, _FOOTER.size))
    if begin == 0:
        return None, ""
    if not len(MAGIC) <= begin <= footer_at:
        return None, "ignoring the damaged index at its end"
    if footer_at - begin > SUMMARY_BYTES_MAX:
        return None, f"ignoring the index at its end, which exceeds {SUMMARY_BYTES_MAX >> 20} MiB"
    if crc and zlib.crc32(file.block(begin, footer_at + HEAD.size + _FOOTER.size - 4 - begin)) != crc:
        return None, "ignoring the damaged index at its end"
    try:
        return _read(file, begin, footer_at), ""
    except (ValueError, struct.error):
        return None, "ignoring the damaged index at its end"


def schema_in(body: bytes | memoryview) -> SchemaName:
    """Decode a schema record. Raises ValueError or struct.error."""
    (schema_id,) = struct.unpack_from("<H", body)
    return SchemaName(schema_id, _text(body, 2)[0])


def channel_in(body: bytes | memoryview) -> Channel:
    """Decode a channel record. Raises ValueError or struct.error."""
    channel_id, schema_id = struct.unpack_from("<HH", body)
    topic, at = _text(body, 4)
    encoding, at = _text(body, at)
    (length,) = struct.unpack_from("<I", body, at)
    at, end = at + 4, at + 4 + length
    if end > len(body):
        raise ValueError("found a channel that ends within its metadata")
    metadata = {}
    while at < end:
        key, at = _text(body, at)
        metadata[key], at = _text(body, at)
    return Channel(channel_id, schema_id, topic, encoding, metadata)


def _read(file: ByteFile, begin: int, end: int) -> Summary:
    found = Summary(begin)
    starts = []
    for kind, at, length in _records(file, begin, end):
        if kind == Kind.SCHEMA:
            schema = schema_in(file.at(at, min(length, 2 * NAME_BYTES_MAX)))
            found.schemas[schema.id] = schema
        elif kind == Kind.CHANNEL:
            channel = channel_in(file.at(at, length))
            found.channels[channel.id] = channel
        elif kind == Kind.STATISTICS:
            _count(found, file.at(at, length))
        elif kind == Kind.CHUNK_INDEX:
            starts.append(struct.unpack("<Q", file.at(at + 16, 8))[0])
            found.in_chunks = True
        elif kind == Kind.ATTACHMENT_INDEX:
            starts.append(struct.unpack("<Q", file.at(at, 8))[0])
    found.starts.extend(sorted(start for start in starts if len(MAGIC) <= start < begin))
    return found


def _records(file: ByteFile, at: int, end: int) -> Iterator[tuple[int, int, int]]:
    while at < end:
        head = file.head(at)
        if head is None or not file.is_sound(at):
            raise ValueError("found no record")
        yield head[0], at + HEAD.size, head[1]
        at += HEAD.size + head[1]


def _count(found: Summary, body: bytes) -> None:
    messages, first_ns, last_ns, length = struct.unpack("<Q18xQQI", body[:46])
    found.span_ns = (first_ns, last_ns) if messages else None
    found.counts = dict(_COUNT.iter_unpack(body[46 : 46 + length]))


def _text(body: bytes | memoryview, at: int) -> tuple[str, int]:
    """Decode a text; return it and the place of its end."""
    (length,) = struct.unpack_from("<I", body, at)
    if length > NAME_BYTES_MAX or at + 4 + length > len(body):
        raise ValueError(f"found a name of {length} bytes, expected at most {NAME_BYTES_MAX}")
    return str(bytes(body[at + 4 : at + 4 + length]), "utf-8"), at + 4 + length
