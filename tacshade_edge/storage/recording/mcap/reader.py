"""Reads any MCAP file, truncated or not, with the package `mcap`; skips and reports damage.

The package parses records; this module finds them, also after damage, which the package cannot, and checks sizes before
anything is unpacked: of a chunk, of a file, and of the unpacked content relative to the file.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Final

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, Message, Schema, Statistics
from mcap.stream_reader import StreamReader

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.quoting import quoted, shown
from tacshade_edge.regular_files import open_regular

MAGIC: Final = b"\x89MCAP0\r\n"
HEAD: Final = struct.Struct("<BQ")  # kind, length
FILE_BYTES_MAX: Final = 1 << 40
CHUNK_BYTES_MAX: Final = 32 << 20
"""Greatest size of a chunk, packed or not, or of a record outside chunks, which a reader must hold in memory."""
DESCRIPTION_BYTES_MAX: Final = 1 << 20
"""Greatest size of a schema or channel."""
SUMMARY_BYTES_MAX: Final = 16 << 20
"""Enough for an index of 100 000 chunks, or 500 GB in chunks of the usual size."""
UNPACKED_MAX: Final = 256
"""Greatest unpacked size over the file's size, beyond `_UNPACKED_FREE_BYTES`; lz4 cannot compress further."""
_UNPACKED_FREE_BYTES: Final = 16 << 20
_RECORD_COSTS_BYTES: Final = 1 << 10
"""Least size that a record counts as, because millions of empty ones take time."""
_WINDOW_BYTES: Final = 1 << 14
_SCAN_BYTES: Final = 1 << 20
_LATER_FIELDS_BYTES: Final = 64
"""Most that later format versions may add to a record; a longer one is another kind with a changed first byte."""
_PASSED_OVER_MAX: Final = 10_000
"""Limit on damaged places in a file, because a file full of damage takes time."""
_DAMAGED: Final = (ValueError, struct.error, McapError, zstandard.ZstdError, RuntimeError, EOFError)

# Number of bytes, or the format of the number that states how many bytes follow it.
_FIELDS: Final[dict[int, tuple[int | str, ...]]] = {
    Opcode.HEADER: ("<I", "<I"),
    Opcode.FOOTER: (20,),
    Opcode.SCHEMA: (2, "<I", "<I", "<I"),
    Opcode.CHANNEL: (4, "<I", "<I", "<I"),
    Opcode.MESSAGE: (22,),
    Opcode.CHUNK: (28, "<I", "<Q"),
    Opcode.MESSAGE_INDEX: (2, "<I"),
    Opcode.CHUNK_INDEX: (32, "<I", 8, "<I", 16),
    Opcode.ATTACHMENT: (16, "<I", "<I", "<Q", 4),
    Opcode.ATTACHMENT_INDEX: (40, "<I", "<I"),
    Opcode.STATISTICS: (42, "<I"),
    Opcode.METADATA: ("<I", "<I"),
    Opcode.METADATA_INDEX: (16, "<I"),
    Opcode.SUMMARY_OFFSET: (17,),
    Opcode.DATA_END: (4,),
}
_END: Final = frozenset(
    (
        *(Opcode.DATA_END, Opcode.FOOTER, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX),
        *(Opcode.STATISTICS, Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET),
    )
)
# A record's head with a length below 2^32. Kinds that also stand inside chunks match only in files without chunks.
_ANY: Final = re.compile(rb"(?=[\x02-\x0f][\s\S]{4}\0{4})")
_OUTSIDE: Final = re.compile(rb"(?=[\x02\x06-\x0f][\s\S]{4}\0{4})")


@dataclass(frozen=True, slots=True)
class Place:
    """A record of plausible length: its kind, its body's first byte, and the body's length."""

    kind: int
    body: int
    length: int

    @property
    def end(self) -> int:
        """The first byte of the next record."""
        return self.body + self.length


@dataclass(frozen=True, slots=True)
class Damage:
    """An unusable part of the file; the records after it may be usable."""

    error: DecodeError


@dataclass(slots=True)
class Summary:
    """The summary at a file's end, which begins at byte `begin`, where the data section ends."""

    begin: int
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)  # messages in each channel, if the file states them
    span_ns: tuple[int, int] | None = None  # times of the first and the last message
    in_chunks: bool = False


class McapFile:
    """An open MCAP file; call `close` after use. Raises ConfigError if it is not MCAP.

    `cut_off`: the writer did not end the file. `damage` describes that of the file's end, for a person, if any.
    """

    def __init__(self, path: Path, stream: BinaryIO | None = None) -> None:
        self._name = shown(path)
        self._stream = _opened(path) if stream is None else stream
        self._size = os.fstat(self._stream.fileno()).st_size  # it may grow
        self._window, self._window_at = b"", 0
        ends = self._block(max(0, self._size - len(MAGIC)), len(MAGIC)) == MAGIC
        self.cut_off = not (ends and self._size >= 2 * len(MAGIC))
        if self.cut_off and self._at(0, len(MAGIC)) != MAGIC:
            self.close()
            raise ConfigError(f"{self._name}: not an MCAP file")
        self.summary, why = self._summary()
        self.damage = f"{self._name}: {why}" if why else ""
        self._unpacked = 0
        self._unpacked_max = _UNPACKED_FREE_BYTES + UNPACKED_MAX * self._size

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def places(self) -> Iterator[Place | Damage]:
        """Every record of the data section, and the damage, in the order of the file.

        After damage, continue at the next record or at the next bytes that form one. In a truncated file, the torn
        record at the end is not damage.
        """
        at, summary, passed_over = len(MAGIC), self.summary, 0
        is_whole = self._block(max(0, self._size - len(MAGIC)), len(MAGIC)) == MAGIC
        end = summary.begin if summary is not None else self._size - len(MAGIC) * is_whole
        in_chunks = True if summary is not None and summary.in_chunks else None
        if self._at(0, len(MAGIC)) != MAGIC:
            yield self._skipping(0, len(MAGIC), "no MCAP file starts with them")
        while at < end:
            head = self._head(at)
            if head is not None and self._is_sound(at):
                place = Place(head[0], at + HEAD.size, head[1])
                if place.kind in _END:
                    return
                in_chunks = True if place.kind == Opcode.CHUNK else in_chunks
                yield place
                at = place.end
                continue
            if head is not None and self._is_private(at, *head):
                at += HEAD.size + head[1]
                continue
            if self._at(at, 1)[0] == Opcode.CHUNK:
                in_chunks = True
            if in_chunks is None:  # searched once, because this may scan the whole file
                chunk = self._found(at + 1, end, _OUTSIDE)
                in_chunks = chunk is not None and self._at(chunk, 1)[0] in (Opcode.CHUNK, Opcode.MESSAGE_INDEX)
            following = self._following(at, end, in_chunks)
            if following is None and not is_whole:
                return  # torn here
            passed_over += 1
            if passed_over > _PASSED_OVER_MAX:
                following = None
            at, begin = end if following is None else following, at
            yield self._skipping(begin, at, "no record of the stated length begins there")

    def records(self) -> Iterator[Schema | Channel | Message | Damage]:
        """The data section's records, in chunks and outside, in the order of the file."""
        self._unpacked = 0
        for place in self.places():
            if isinstance(place, Damage):
                yield place
                continue
            if place.kind not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK):
                continue
            try:
                yield from self._records_at(place)
            except _DAMAGED as error:
                what = "chunk" if place.kind == Opcode.CHUNK else "record"
                found = f"{self._name}: skipping the damaged {what} at byte {place.body - HEAD.size}: {error}"
                yield Damage(DecodeError(found))
            if self._unpacked > self._unpacked_max:
                found = f"{self._name}: skipping the data after byte {place.end}: found more than "
                expected = f"{self._unpacked_max} unpacked bytes, expected at most {UNPACKED_MAX} times the file's size"
                yield Damage(DecodeError(found + expected))
                return

    def attachment(self, place: Place, bytes_max: dict[str, int]) -> tuple[str, bytes | None]:
        """An attachment's name, cut to 255 bytes, and its data; None if it is not in `bytes_max` and too large to
        check.

        Raises ValueError with a line for a person if it exceeds its size there, or is damaged.
        """
        length = self._number("<I", place.body + 16)
        name = str(self._at(place.body + 20, min(length, 255)), "utf-8", "replace")
        if name not in bytes_max and place.length > CHUNK_BYTES_MAX:
            return name, None
        try:  # other names too: a damaged name may have been one of these
            media_at = place.body + 20 + length
            data_at = media_at + 4 + self._number("<I", media_at) + 8
            size, most = self._number("<Q", data_at - 8), bytes_max.get(name, CHUNK_BYTES_MAX)
            if size > most:
                raise ValueError(f"found {size} bytes, expected at most {most}")
            if (fits := place.end - 4 - data_at) != size:
                raise ValueError(f"found {size} bytes, expected {fits} before its checksum")
            body = self._block(place.body, place.length)
            crc = int.from_bytes(body[-4:], "little")
            if crc and zlib.crc32(body[:-4]) != crc:
                raise ValueError("its checksum does not match")
            record = _record(Opcode.ATTACHMENT, body)
        except _DAMAGED as error:
            raise ValueError(f"{self._name}: leaving its {shown(name)} out: {error}") from None
        assert isinstance(record, Attachment)
        return name, record.data

    def _records_at(self, place: Place) -> Iterator[Schema | Channel | Message]:
        is_chunk = place.kind == Opcode.CHUNK
        size = self._number("<Q", place.body + 16) if is_chunk else place.length
        if (most := max(size, place.length)) > CHUNK_BYTES_MAX:
            raise ValueError(f"found {most} bytes, expected at most {CHUNK_BYTES_MAX}")
        self._unpacked += size
        if self._unpacked > self._unpacked_max:
            return
        body = self._block(place.body, place.length)
        if not is_chunk:
            self._unpacked += max(0, _RECORD_COSTS_BYTES - size)
            yield _record(place.kind, body)
            return
        data = memoryview(_unpacked(_record(place.kind, body)))
        at = 0
        while at < len(data) and self._unpacked <= self._unpacked_max:
            kind, length = HEAD.unpack_from(data, at)
            at += HEAD.size
            if length > len(data) - at:
                raise ValueError(f"found a record of {length} bytes in it, expected at most {len(data) - at}")
            self._unpacked += max(0, _RECORD_COSTS_BYTES - length)
            if kind in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                yield _record(kind, data[at : at + length])
            at += length

    def _summary(self) -> tuple[Summary | None, str]:
        """The summary; None and a reason if it is unusable, None and an empty text if there is none."""
        damaged = None, "ignoring the damaged index at its end"
        footer_at = self._size - HEAD.size - 20 - len(MAGIC)
        if footer_at < len(MAGIC) or self.cut_off:
            return None, ""
        if self._head(footer_at) != (Opcode.FOOTER, 20):
            return damaged
        footer = _record(Opcode.FOOTER, self._at(footer_at + HEAD.size, 20))
        assert isinstance(footer, Footer)
        if (begin := footer.summary_start) == 0:
            return None, ""
        if not len(MAGIC) <= begin <= footer_at:
            return damaged
        if footer_at - begin > SUMMARY_BYTES_MAX:
            return None, f"ignoring the index at its end, which exceeds {SUMMARY_BYTES_MAX >> 20} MiB"
        crc = footer.summary_crc
        if crc and zlib.crc32(self._block(begin, footer_at + HEAD.size + 16 - begin)) != crc:
            return damaged
        try:
            return self._summary_at(begin, footer_at), ""
        except _DAMAGED:
            return damaged

    def _summary_at(self, at: int, end: int) -> Summary:
        found = Summary(at)
        while at < end:
            head = self._head(at)
            if head is None or not self._is_sound(at):
                raise ValueError("found no record")
            kind, length = head
            body = at + HEAD.size
            if kind in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
                record = _record(kind, self._block(body, length))
                if isinstance(record, Schema):
                    found.schemas[record.id] = record
                elif isinstance(record, Channel):
                    found.channels[record.id] = record
                elif isinstance(record, Statistics):
                    times = record.message_start_time, record.message_end_time
                    found.span_ns = times if record.message_count else None
                    found.counts = record.channel_message_counts
            found.in_chunks |= kind == Opcode.CHUNK_INDEX
            at = body + length
        return found

    def _skipping(self, begin: int, end: int, why: str) -> Damage:
        return Damage(DecodeError(f"{self._name}: skipping the damaged bytes {begin} to {end}: {why}"))

    def _is_private(self, at: int, kind: int, length: int) -> bool:
        """Whether to skip an unknown kind as private; needs message counts, which reveal a message lost this way."""
        counts = self.summary is not None and bool(self.summary.counts)
        return counts and kind > max(Opcode) and self._begins_record(at + HEAD.size + length)

    def _following(self, at: int, end: int, in_chunks: bool) -> int | None:
        """The first byte of the next sound record after a damaged one; None if there is none."""
        if (head := self._head(at)) is not None:
            behind = at + HEAD.size + head[1]
            if behind < end and self._is_sound(behind):
                return behind
        return self._found(at + 1, end, _OUTSIDE if in_chunks else _ANY)

    def _found(self, begin: int, end: int, head: re.Pattern[bytes]) -> int | None:
        """The first place of a sound record with something like a record after it; None if there is none."""
        while begin < end:
            block = self._block(begin, min(_SCAN_BYTES, end - begin))
            # A power cut can leave many zeros, at which no record begins.
            for match in head.finditer(block) if block.count(0) < len(block) else ():
                at = begin + match.start()
                found = self._head(at)
                if found is not None and self._is_sound(at) and self._begins_record(at + HEAD.size + found[1]):
                    return at
            if len(block) <= HEAD.size:
                return None
            begin += len(block) - HEAD.size + 1
        return None

    def _is_sound(self, at: int) -> bool:
        """Whether the record at `at` is as long as its own fields say.

        After a message, or a record with unknown additional fields, something like a record must follow.
        """
        if (head := self._head(at)) is None:
            return False
        kind, length = head
        stated = 0
        for field_ in _FIELDS.get(kind, (length + 1,)):
            if isinstance(field_, str):
                number = self._at(at + HEAD.size + stated, struct.calcsize(field_))
                stated += len(number) + int.from_bytes(number, "little")
            else:
                stated += field_
            if stated > length:
                return False
        if kind != Opcode.MESSAGE and stated == length:
            return True
        is_possible = kind == Opcode.MESSAGE or length - stated <= _LATER_FIELDS_BYTES
        return is_possible and self._begins_record(at + HEAD.size + length)

    def _begins_record(self, at: int) -> bool:
        """Whether a record of a known kind may begin at `at`, or the file ends there."""
        if at >= self._size or self._at(at, len(MAGIC)) == MAGIC:
            return True
        head = self._head(at)
        return head is not None and head[0] in _FIELDS

    def _head(self, at: int) -> tuple[int, int] | None:
        """The kind and length of the record at `at`; None if the file is too short for it."""
        head = self._at(at, HEAD.size)
        if len(head) < HEAD.size:
            return None
        kind, length = HEAD.unpack(head)
        return (kind, length) if at + HEAD.size + length <= self._size else None

    def _number(self, form: str, at: int) -> int:
        return int(struct.unpack(form, self._at(at, struct.calcsize(form)))[0])

    def _at(self, at: int, count: int) -> bytes:
        """Read a few bytes, fewer at the end of the file, and buffer those after them."""
        if at < self._window_at or at + count > self._window_at + len(self._window):
            self._window, self._window_at = self._block(at, max(count, _WINDOW_BYTES)), at
        return self._window[at - self._window_at : at - self._window_at + count]

    def _block(self, at: int, count: int) -> bytes:
        """Read many bytes, fewer at the end of the file."""
        left = max(0, min(count, self._size - at))
        parts = []
        while left and (part := os.pread(self._stream.fileno(), left, at)):
            parts.append(part)
            left, at = left - len(part), at + len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)


def attachments_in(path: Path, bytes_max: dict[str, int]) -> tuple[dict[str, bytes], list[str]]:
    """The attachments with the names in `bytes_max`, each up to its size there, the last one of each name; and a line
    for each damaged or too large one, and for every damaged place in the file. Raises ConfigError if it is not MCAP.
    """
    found: dict[str, bytes] = {}
    damage: list[str] = []
    with contextlib.closing(McapFile(path)) as file:
        for place in file.places():
            if isinstance(place, Damage):
                damage.append(str(place.error))
            elif place.kind == Opcode.ATTACHMENT:
                try:
                    name, data = file.attachment(place, bytes_max)
                except ValueError as error:
                    damage.append(str(error))
                    continue
                if name in bytes_max and data is not None:
                    found[name] = data
    return found, damage


def _record(kind: int, body: bytes | memoryview) -> Schema | Channel | Message:
    """The record, parsed by the package. Raises one of `_DAMAGED`."""
    most = DESCRIPTION_BYTES_MAX if kind in (Opcode.SCHEMA, Opcode.CHANNEL) else len(body)
    stream = io.BytesIO(HEAD.pack(kind, len(body)) + body)
    return next(iter(StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=most).records))


def _unpacked(chunk: object) -> bytes:
    """A chunk's records, in no more memory than its stated size, which the package does not limit, allows."""
    assert isinstance(chunk, Chunk)
    size, packed = chunk.uncompressed_size, chunk.data
    if chunk.compression == "zstd":
        decompressor = zstandard.ZstdDecompressor(max_window_size=CHUNK_BYTES_MAX)
        data = decompressor.stream_reader(packed).read(size)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size)
    elif chunk.compression == "":
        data = packed
    else:
        raise ValueError(f"found the compression {quoted(chunk.compression[:64])}, expected zstd, lz4")
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise ValueError("its checksum does not match")
    return bytes(data)


def _opened(path: Path) -> BinaryIO:
    try:
        try:
            return open_regular(path, FILE_BYTES_MAX)
        except FileNotFoundError:  # its writer has ended it meanwhile
            return open_regular(path.with_name(path.name.removesuffix(".part")), FILE_BYTES_MAX)
    except OSError as error:
        raise ConfigError(f"{shown(path)}: {error.strerror or error}, expected an MCAP file") from None
