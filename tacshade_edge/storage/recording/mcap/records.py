"""Reads the records of any MCAP file, truncated or not, and checks sizes before it unpacks anything.

It limits the size of a chunk, of a file, and of the unpacked content relative to the file.
"""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import lz4.frame
import zstandard

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.quoting import quoted, shown
from tacshade_edge.regular_files import open_regular
from tacshade_edge.storage.recording.mcap.layout import HEAD, MAGIC, ByteFile, Kind
from tacshade_edge.storage.recording.mcap.summary import Channel, SchemaName, channel_in, read_summary, schema_in
from tacshade_edge.storage.recording.mcap.walk import Damage, Place, places

FILE_BYTES_MAX: Final = 1 << 40
CHUNK_BYTES_MAX: Final = 32 << 20
"""Greatest size of a chunk, packed or not, or of a record outside chunks, which a reader must hold in memory."""
UNPACKED_MAX: Final = 256
"""Greatest unpacked size over the file's size, beyond `_UNPACKED_FREE_BYTES`; lz4 cannot compress further."""
_UNPACKED_FREE_BYTES: Final = 16 << 20
_RECORD_COSTS_BYTES: Final = 1 << 10
"""Least size that a record counts as, because millions of empty ones take time."""
_MESSAGE: Final = struct.Struct("<HIQQ")
_CHUNK: Final = struct.Struct("<16xQII")  # unpacked size, its CRC-32, length of the compression's name
_DAMAGED: Final = (ValueError, struct.error, zstandard.ZstdError, RuntimeError, EOFError)


@dataclass(frozen=True, slots=True)
class Message:
    """A message of a channel; `log_ns` is its recording time."""

    channel_id: int
    sequence: int
    log_ns: int
    data: memoryview


class McapFile:
    """An open MCAP file; call `close` after use.

    Attributes
    ----------
    cut_off : bool
        The writer did not end the file.
    summary : Summary or None
        The summary at the file's end, if usable.
    damage : str
        The damage to the file's end, for a person; empty if there is none.

    Raises
    ------
    ConfigError
        The file is not MCAP.
    """

    def __init__(self, path: Path) -> None:
        self._name = shown(path)
        self._stream = _opened(path)
        self._file = ByteFile(self._stream)
        ends = self._file.block(max(0, self._file.size - len(MAGIC)), len(MAGIC)) == MAGIC
        self.cut_off = not (ends and self._file.size >= 2 * len(MAGIC))
        if self.cut_off and self._file.at(0, len(MAGIC)) != MAGIC:
            self._stream.close()
            raise ConfigError(f"{self._name}: not an MCAP file")
        self.summary, why = read_summary(self._file)
        self.damage = f"{self._name}: {why}" if why else ""
        self._unpacked = 0

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def places(self) -> Iterator[Place | Damage]:
        """The places of the file's records, and the damaged ones between them."""
        yield from places(self._file, self._name, self.summary)

    def records(self) -> Iterator[SchemaName | Channel | Message | Damage]:
        """The data section's records, in chunks and outside, in the order of the file."""
        self._unpacked = 0
        for place in self.places():
            if isinstance(place, Damage):
                yield place
                continue
            if place.kind not in (Kind.SCHEMA, Kind.CHANNEL, Kind.MESSAGE, Kind.CHUNK):
                continue
            try:
                yield from self._records_at(place)
            except _DAMAGED as error:
                what = "chunk" if place.kind == Kind.CHUNK else "record"
                found = f"{self._name}: skipping the damaged {what} at byte {place.body - HEAD.size}: {error}"
                yield Damage(DecodeError(found))
            if self._unpacked > self._unpacked_max:
                found = f"{self._name}: skipping the data after byte {place.end}: found more than "
                expected = f"{self._unpacked_max} unpacked bytes, expected at most {UNPACKED_MAX} times the file's size"
                yield Damage(DecodeError(found + expected))
                return

    def attachment(self, place: Place, bytes_max: int) -> bytes:
        """The data of an attachment. Raises ValueError if it exceeds `bytes_max` or is damaged."""
        name_end = place.body + 20 + self._number("<I", place.body + 16)
        data_at = name_end + 4 + self._number("<I", name_end) + 8
        size = self._number("<Q", data_at - 8)
        if size > bytes_max:
            raise ValueError(f"found {size} bytes, expected at most {bytes_max}")
        if (fits := place.end - 4 - data_at) != size:
            raise ValueError(f"found {size} bytes, expected {fits} before its checksum")
        crc = self._number("<I", place.end - 4)
        data = self._file.block(data_at, size)
        if crc and zlib.crc32(data, zlib.crc32(self._file.block(place.body, data_at - place.body))) != crc:
            raise ValueError("its checksum does not match")
        return data

    def attachment_name(self, place: Place) -> str:
        """The attachment's name, cut to 255 bytes."""
        length = self._number("<I", place.body + 16)
        return str(self._file.at(place.body + 20, min(length, 255)), "utf-8", "replace")

    @property
    def _unpacked_max(self) -> int:
        return _UNPACKED_FREE_BYTES + UNPACKED_MAX * self._file.size

    def _number(self, form: str, at: int) -> int:
        return int(struct.unpack(form, self._file.at(at, struct.calcsize(form)))[0])

    def _records_at(self, place: Place) -> Iterator[SchemaName | Channel | Message]:
        if place.length > CHUNK_BYTES_MAX:
            raise ValueError(f"found {place.length} bytes, expected at most {CHUNK_BYTES_MAX}")
        size = self._number("<Q", place.body + 16) if place.kind == Kind.CHUNK else place.length
        if size > CHUNK_BYTES_MAX:
            raise ValueError(f"found {size} bytes, expected at most {CHUNK_BYTES_MAX}")
        self._unpacked += size
        if self._unpacked > self._unpacked_max:
            return
        body = memoryview(self._file.block(place.body, place.length))
        if place.kind != Kind.CHUNK:
            self._unpacked += max(0, _RECORD_COSTS_BYTES - size)
            yield _record(place.kind, body)
            return
        data = memoryview(_unpacked(body))
        at = 0
        while at < len(data) and self._unpacked <= self._unpacked_max:
            kind, length = HEAD.unpack_from(data, at)
            at += HEAD.size
            if length > len(data) - at:
                raise ValueError(f"found a record of {length} bytes in it, expected at most {len(data) - at}")
            self._unpacked += max(0, _RECORD_COSTS_BYTES - length)
            if kind in (Kind.SCHEMA, Kind.CHANNEL, Kind.MESSAGE):
                yield _record(kind, data[at : at + length])
            at += length


def attachments_in(path: Path, bytes_max: dict[str, int]) -> tuple[dict[str, bytes], list[str]]:
    """The attachments with the names in `bytes_max`, each up to its size there; the last one of each name.

    Returns
    -------
    dict of str to bytes
    list of str
        A line for each damaged or too large attachment, and for every damaged place in the file.

    Raises
    ------
    ConfigError
        The file is not MCAP.
    """
    found: dict[str, bytes] = {}
    damage: list[str] = []
    with contextlib.closing(McapFile(path)) as file:
        for place in file.places():
            if isinstance(place, Damage):
                damage.append(str(place.error))
            elif place.kind == Kind.ATTACHMENT:
                name = file.attachment_name(place)
                if name not in bytes_max and place.length > CHUNK_BYTES_MAX:
                    continue
                try:  # check other names too: a damaged name may have been one of these
                    data = file.attachment(place, bytes_max.get(name, CHUNK_BYTES_MAX))
                except ValueError as error:
                    damage.append(f"{shown(path)}: leaving its {shown(name)} out: {error}")
                    continue
                if name in bytes_max:
                    found[name] = data
    return found, damage


def _record(kind: int, body: memoryview) -> SchemaName | Channel | Message:
    if kind == Kind.SCHEMA:
        return schema_in(body)
    if kind == Kind.CHANNEL:
        return channel_in(body)
    channel_id, sequence, log_ns, _ = _MESSAGE.unpack_from(body)
    return Message(channel_id, sequence, log_ns, body[_MESSAGE.size :])


def _unpacked(chunk: memoryview) -> bytes | memoryview:
    """Unpack a chunk's records in no more memory than its stated size and `CHUNK_BYTES_MAX`."""
    size, crc, name_bytes = _CHUNK.unpack_from(chunk)
    at = _CHUNK.size + name_bytes
    compression = bytes(chunk[_CHUNK.size : at][:64])
    (length,) = struct.unpack_from("<Q", chunk, at)
    packed = chunk[at + 8 : at + 8 + length]
    data: bytes | memoryview
    if compression == b"zstd":
        decompressor = zstandard.ZstdDecompressor(max_window_size=CHUNK_BYTES_MAX)
        data = decompressor.stream_reader(packed).read(size)
    elif compression == b"lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size)
    elif compression == b"":
        data = packed
    else:
        raise ValueError(f"found the compression {quoted(compression.decode('utf-8', 'replace'))}, expected zstd, lz4")
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        raise ValueError("its checksum does not match")
    return data


def _opened(path: Path) -> BinaryIO:
    try:
        try:
            return open_regular(path, FILE_BYTES_MAX)
        except FileNotFoundError:  # its writer has ended it meanwhile
            return open_regular(path.with_name(path.name.removesuffix(".part")), FILE_BYTES_MAX)
    except OSError as error:
        raise ConfigError(f"{shown(path)}: {error.strerror or error}, expected an MCAP file") from None
