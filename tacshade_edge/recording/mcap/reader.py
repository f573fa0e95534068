"""Reads any MCAP file, truncated or not, with the package `mcap`; skips and reports damage.

The package trusts every length that it reads and ends at the first damage. So it gets one record
at a time, whose size was checked, and reading goes on at the next chunk or attachment that the
file's index names.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
import zlib
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Footer,
    McapRecord,
    Message,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.quoting import quoted, shown
from tacshade_edge.regular_files import open_regular

_MAGIC: Final = b"\x89MCAP0\r\n"
# Kind, length.
_HEAD: Final = struct.Struct("<BQ")
_FILE_BYTES_MAX: Final = 1 << 40
# Packed or not, or of a record outside chunks: a reader must hold it in memory.
CHUNK_BYTES_MAX: Final = 32 << 20
# Of a schema or channel, which are kept while the file is read.
DESCRIPTION_BYTES_MAX: Final = 1 << 20
# Enough for an index of 100 000 chunks, or 500 GB in chunks of the usual size.
SUMMARY_BYTES_MAX: Final = 16 << 20
# Greatest unpacked size over the file's size: lz4 cannot compress further. zstd can, and a file of
# a few kB would then keep a reader busy for hours.
_UNPACKED_MAX: Final = 256
_UNPACKED_FREE_BYTES: Final = 16 << 20  # beyond `_UNPACKED_MAX`
# Places in a file: each costs a line of the log.
_DAMAGED_MAX: Final = 10_000
_DAMAGED: Final = (ValueError, struct.error, McapError, zstandard.ZstdError, RuntimeError, EOFError)
_KINDS: Final = frozenset(int(kind) for kind in Opcode)
# Also what follows the data's end: a flipped bit may have hidden the end itself.
_END: Final = frozenset(
    {Opcode.DATA_END, Opcode.FOOTER, Opcode.CHUNK_INDEX, Opcode.STATISTICS, Opcode.SUMMARY_OFFSET}
)


class _TooLargeError(ValueError):
    """A stated size beyond what a reader may hold in memory."""


class Place(NamedTuple):
    """A record that ends where another may begin: its kind, its body's first byte and length,
    and the next record's first byte.
    """

    kind: int
    body: int
    length: int
    end: int


@dataclass(slots=True)
class Summary:
    """The summary at a file's end, which begins at byte `begin`, where the data section ends."""

    begin: int
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    # Messages in each channel, if the file states them.
    counts: dict[int, int] = field(default_factory=dict)
    # Times of the first and the last message.
    span_ns: tuple[int, int] | None = None
    # First byte to kind, of the chunks and attachments that it names.
    places: dict[int, int] = field(default_factory=dict)


class McapFile:
    """An open MCAP file; call `close` after use.

    `cut_off`: its writer did not end it; `damage`: of its end, for a person.
    Raises ConfigError if it is not MCAP.
    """

    def __init__(self, path: Path) -> None:
        self._name = shown(path)
        self._stream = _opened(path)
        # Once: it may be growing.
        self._size = os.fstat(self._stream.fileno()).st_size
        self._ends = self._read(max(0, self._size - len(_MAGIC)), len(_MAGIC)) == _MAGIC
        self.cut_off = not (self._ends and self._size >= 2 * len(_MAGIC))
        if self.cut_off and self._read(0, len(_MAGIC)) != _MAGIC:
            self.close()
            raise ConfigError(f"{self._name}: not an MCAP file")
        self.summary: Summary | None = None
        self.damage = ""
        try:
            self.summary = self._summary()
        except _DAMAGED:
            self.damage = f"{self._name}: ignoring the damaged or too large index at its end"
        self._unpacked = 0
        self._unpacked_max = _UNPACKED_FREE_BYTES + _UNPACKED_MAX * self._size

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def places(self) -> Iterator[Place | DecodeError]:
        """Every record of the data section, and the damage, after which it continues at the next
        record that the index names. In a truncated file, the torn record at the end is not damage.
        """
        at, damaged = len(_MAGIC), 0
        end = self._size - len(_MAGIC) * self._ends if self.summary is None else self.summary.begin
        named = {} if self.summary is None else self.summary.places
        # A record must not reach into the next one that the index names: a flipped bit in its
        # length would otherwise skip sound chunks.
        stops = [*sorted(place for place in named if at < place < end), end]
        if self._read(0, len(_MAGIC)) != _MAGIC:
            yield self._skipping(0, at)
        while at < end:
            stop = stops[bisect_right(stops, at)]
            place = self._place(at, stop)
            if place is None or named.get(at, place.kind) != place.kind:
                if stop == end and not self._ends:
                    return  # torn here
                damaged += 1
                stop = end if damaged > _DAMAGED_MAX else stop
                yield self._skipping(at, stop)
                at = stop
            elif place.kind in _END and stop == end:
                return
            else:
                yield place if place.kind in _KINDS else self._skipping(at, place.end)
                at = place.end

    def records(self) -> Iterator[Schema | Channel | Message | DecodeError]:
        """The data section's records, in chunks and outside, in the order of the file."""
        self._unpacked = 0
        for place in self.places():
            if isinstance(place, DecodeError):
                yield place
                continue
            if place.kind not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK):
                continue
            try:
                yield from self._records_at(place)
            except _DAMAGED as error:
                what = "chunk" if place.kind == Opcode.CHUNK else "record"
                # Nothing shows whether the size is wrong or another program writes larger chunks.
                how = "damaged or too large" if isinstance(error, _TooLargeError) else "damaged"
                at = place.body - _HEAD.size
                found = f"{self._name}: skipping the {how} {what} at byte {at}: {error}"
                yield DecodeError(found)
            if self._unpacked > self._unpacked_max:
                found = f"{self._name}: skipping the data after byte {place.end}: found more than "
                expected = (
                    f"{self._unpacked_max} unpacked bytes, "
                    f"expected at most {_UNPACKED_MAX} times the file's size"
                )
                yield DecodeError(found + expected)
                return

    def attachment(self, place: Place, bytes_max: dict[str, int]) -> Attachment | None:
        """The attachment at a place, None if its name is not in `bytes_max`.

        Raises ValueError with a line for a person if it exceeds its size there, or is damaged.
        """
        length = int.from_bytes(self._read(place.body + 16, 4), "little")
        name = str(self._read(place.body + 20, min(length, 255)), "utf-8", "replace")
        # Other names, too: a damaged name may have been one of these.
        try:
            if place.length > (most := bytes_max.get(name, CHUNK_BYTES_MAX)):
                if name not in bytes_max:
                    return None
                raise ValueError(f"found {place.length} bytes, expected at most {most}")
            body = self._read(place.body, place.length)
            # The package skips the checksum.
            crc = int.from_bytes(body[-4:], "little")
            if crc and zlib.crc32(body[:-4]) != crc:
                raise ValueError("its checksum does not match")
            record = _record(Opcode.ATTACHMENT, body)
        except _DAMAGED as error:
            raise ValueError(f"{self._name}: leaving its {shown(name)} out: {error}") from None
        assert isinstance(record, Attachment)
        return record if record.name in bytes_max else None

    def _records_at(self, place: Place) -> Iterator[Schema | Channel | Message]:
        _require_small(place.length)
        record = _record(place.kind, self._read(place.body, place.length))
        if isinstance(record, Schema | Channel | Message):
            yield record
        if not isinstance(record, Chunk):
            return
        _require_small(record.uncompressed_size)
        self._unpacked += record.uncompressed_size
        if self._unpacked > self._unpacked_max:
            return
        data, at = memoryview(_unpacked(record)), 0
        while at < len(data):
            kind, length = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            if length > len(data) - at:
                raise ValueError(
                    f"found a record of {length} bytes in it, expected at most {len(data) - at}"
                )
            inner = _record(kind, data[at : at + length])
            if isinstance(inner, Schema | Channel | Message):
                yield inner
            at += length

    def _summary(self) -> Summary | None:
        """The summary; None if there is none. Raises one of `_DAMAGED` if it is unusable."""
        footer_at = self._size - _HEAD.size - 20 - len(_MAGIC)
        if footer_at < len(_MAGIC) or self.cut_off:
            return None
        place = self._place(footer_at, self._size)
        if place is None or (place.kind, place.length) != (Opcode.FOOTER, 20):
            raise ValueError("found no footer")
        footer = _record(place.kind, self._read(place.body, place.length))
        assert isinstance(footer, Footer)
        if (begin := footer.summary_start) == 0:
            return None
        if not len(_MAGIC) <= begin <= footer_at or footer_at - begin > SUMMARY_BYTES_MAX:
            raise ValueError("another beginning")
        data = self._read(begin, self._size - begin)
        # The package does not check it.
        if (
            footer.summary_crc
            and zlib.crc32(data[: footer_at - begin + _HEAD.size + 16]) != footer.summary_crc
        ):
            raise ValueError("its checksum does not match")
        found = Summary(begin)
        for record in StreamReader(io.BytesIO(data), skip_magic=True, emit_chunks=True).records:
            if isinstance(record, Schema):
                found.schemas[record.id] = record
            elif isinstance(record, Channel):
                found.channels[record.id] = record
            elif isinstance(record, Statistics):
                times = record.message_start_time, record.message_end_time
                found.span_ns = times if record.message_count else None
                found.counts = record.channel_message_counts
            elif isinstance(record, ChunkIndex):
                found.places[record.chunk_start_offset] = Opcode.CHUNK
            elif isinstance(record, AttachmentIndex):
                found.places[record.offset] = Opcode.ATTACHMENT
        return found

    def _skipping(self, begin: int, end: int) -> DecodeError:
        found = f"{self._name}: skipping the damaged bytes {begin} to {end}"
        return DecodeError(f"{found}: found no known record that ends there")

    def _place(self, at: int, stop: int) -> Place | None:
        """The record at `at`; None if it is none or does not end before `stop`."""
        head = self._read(at, _HEAD.size)
        if len(head) < _HEAD.size:
            return None
        kind, length = _HEAD.unpack(head)
        end = at + _HEAD.size + length
        return Place(kind, at + _HEAD.size, length, end) if kind != 0 and end <= stop else None

    def _read(self, at: int, count: int) -> bytes:
        """Some bytes, fewer at the end of the file."""
        self._stream.seek(at)
        return self._stream.read(max(0, min(count, self._size - at)))


def attachments_in(path: Path, bytes_max: dict[str, int]) -> tuple[dict[str, bytes], list[str]]:
    """The attachments with the names in `bytes_max`, each up to its size there, the last one of
    each name; and a line for each damaged or too large one, and for every damaged place in the
    file.

    Raises ConfigError if it is not MCAP.
    """
    found: dict[str, bytes] = {}
    damage: list[str] = []
    with contextlib.closing(McapFile(path)) as file:
        for place in file.places():
            if isinstance(place, DecodeError):
                damage.append(str(place))
            elif place.kind == Opcode.ATTACHMENT:
                try:
                    if (attached := file.attachment(place, bytes_max)) is not None:
                        found[attached.name] = attached.data
                except ValueError as error:
                    damage.append(str(error))
    return found, damage


def _record(kind: int, body: bytes | memoryview) -> McapRecord | None:
    """The record, parsed by the package; None if its kind is unknown. Raises one of `_DAMAGED`."""
    # A stream of its own: no length inside the record can reach beyond it.
    most = DESCRIPTION_BYTES_MAX if kind in (Opcode.SCHEMA, Opcode.CHANNEL) else len(body)
    stream = io.BytesIO(_HEAD.pack(kind, len(body)) + body)
    reader = StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=most)
    return next(iter(reader.records)) if kind in _KINDS else None


def _require_small(size: int) -> None:
    if size > CHUNK_BYTES_MAX:
        raise _TooLargeError(f"found {size} bytes, expected at most {CHUNK_BYTES_MAX}")


def _unpacked(chunk: Chunk) -> bytes:
    """A chunk's records, in no more memory than its stated size, which the package does not limit,
    allows.
    """
    size, packed = chunk.uncompressed_size, chunk.data
    if chunk.compression == "zstd":
        # The window is memory that the packed bytes ask for, beside what they unpack to.
        decompressor = zstandard.ZstdDecompressor(max_window_size=CHUNK_BYTES_MAX)
        data = decompressor.stream_reader(packed).read(size)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size)
    elif chunk.compression == "":
        data = packed
    else:
        raise ValueError(
            f"found the compression {quoted(chunk.compression[:64])}, expected zstd, lz4"
        )
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise ValueError("its checksum does not match")
    return bytes(data)


def _opened(path: Path) -> BinaryIO:
    try:
        try:
            return open_regular(path, _FILE_BYTES_MAX)
        # Its writer has ended it meanwhile.
        except FileNotFoundError:
            return open_regular(path.with_name(path.name.removesuffix(".part")), _FILE_BYTES_MAX)
    except OSError as error:
        raise ConfigError(
            f"{shown(path)}: {error.strerror or error}, expected an MCAP file"
        ) from None
