"""What is in an MCAP file, record by record, however it ends: a file is read to its last whole chunk."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.quoting import shown
from tacshade_edge.regular_files import open_regular

FILE_BYTES_MAX: Final = 1 << 40
RECORD_BYTES_MAX: Final = 256 << 20
"""Of a chunk, compressed or not, or an attachment: what a reader must hold."""
MAGIC: Final = b"\x89MCAP0\r\n"
_RECORD_HEAD: Final = struct.Struct("<BQ")  # opcode, length
_DAMAGED: Final = (McapError, struct.error, ValueError, zstandard.ZstdError, RuntimeError, EOFError)


@dataclass(frozen=True, slots=True)
class Damage:
    """A chunk that cannot be used; what comes after it can."""

    error: DecodeError


def ends_whole(path: Path) -> bool:
    """Whether its writer ended it. Raises ConfigError where it is no MCAP file."""
    with _opened(path) as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise ConfigError(f"{shown(path)}: found no MCAP file, expected one")
        size = stream.seek(0, 2)
        stream.seek(max(0, size - len(MAGIC)))
        return size >= 2 * len(MAGIC) and stream.read() == MAGIC


def records_of(path: Path) -> Iterator[Schema | Channel | Message | Attachment | Metadata | Damage]:
    """Every record of the data section in the order of the file.

    It ends where the file does, or where it was torn: `ends_whole` tells. Raises ConfigError where it cannot be read.
    """
    with _opened(path) as stream:
        yield from _records(path, stream)


def summary_of(path: Path) -> list[Schema | Channel]:
    """Schemas, then channels, as the end of a whole file repeats them; empty where it does not, or is damaged."""
    summary = _summary(path)
    return [] if summary is None else [*summary.schemas.values(), *summary.channels.values()]


def times_of(path: Path) -> tuple[int, int] | None:
    """Times of the first and the last message in ns, as the end of a whole file has them; None where it has not."""
    summary = _summary(path)
    found = None if summary is None else summary.statistics
    if found is None or found.message_count == 0:
        return None
    return found.message_start_time, found.message_end_time


def _summary(path: Path) -> Summary | None:
    with _opened(path) as stream:
        try:
            return SeekingReader(stream, record_size_limit=RECORD_BYTES_MAX).get_summary()
        except _DAMAGED:
            return None


def _records(path: Path, stream: BinaryIO) -> Iterator[Schema | Channel | Message | Attachment | Metadata | Damage]:
    size = stream.seek(0, 2)
    stream.seek(len(MAGIC))
    records = StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=RECORD_BYTES_MAX).records
    while True:
        at = stream.tell()
        head = stream.read(_RECORD_HEAD.size)
        if len(head) < _RECORD_HEAD.size or at + len(head) + _RECORD_HEAD.unpack(head)[1] > size:
            return  # torn here
        stream.seek(at)
        try:
            record = next(records, None)
        except _DAMAGED:
            return  # a length that is none: nothing after it can be found
        if record is None:
            return
        if not isinstance(record, Chunk):
            if isinstance(record, Schema | Channel | Message | Attachment | Metadata):
                yield record
            continue
        try:
            inside = _opened_chunk(record)
        except _DAMAGED as error:
            yield Damage(DecodeError(f"{shown(path)}: the chunk at byte {at} is damaged: {error}"))
            continue
        for inner in inside:
            if isinstance(inner, Schema | Channel | Message):
                yield inner


def _opened_chunk(chunk: Chunk) -> list[McapRecord]:
    """Its records. Never more memory than `RECORD_BYTES_MAX`, whatever the chunk says of itself."""
    size = chunk.uncompressed_size
    if size > RECORD_BYTES_MAX:
        raise ValueError(f"found {size} bytes, expected at most {RECORD_BYTES_MAX}")
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"found the compression {chunk.compression!r}, expected zstd or lz4")
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise ValueError("the checksum is not its own")
    plain = Chunk(
        compression="",
        data=data,
        message_end_time=chunk.message_end_time,
        message_start_time=chunk.message_start_time,
        uncompressed_crc=0,
        uncompressed_size=size,
    )
    return list(breakup_chunk(plain))


def _opened(path: Path) -> BinaryIO:
    try:
        return open_regular(path, FILE_BYTES_MAX)
    except OSError as error:
        raise ConfigError(f"{shown(path)}: {error.strerror or error}, expected an MCAP file") from None
