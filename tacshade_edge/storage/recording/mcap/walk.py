"""Walks the records of an MCAP file's data section, skipping and reporting damage."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from tacshade_edge.errors import DecodeError
from tacshade_edge.storage.recording.mcap.layout import HEAD, MAGIC, ByteFile, Kind
from tacshade_edge.storage.recording.mcap.summary import Summary

_SCAN_BYTES: Final = 1 << 20
_PASSED_OVER_MAX: Final = 10_000
"""Limit on damaged places in a file, because a file full of damage takes time."""
_INDEXED_MAX: Final = 16
"""Number of next chunks tried from the index; if all are damaged, or the index is wrong, the bytes are searched."""
_END: Final = frozenset(
    (
        *(Kind.DATA_END, Kind.FOOTER, Kind.CHUNK_INDEX, Kind.ATTACHMENT_INDEX),
        *(Kind.STATISTICS, Kind.METADATA_INDEX, Kind.SUMMARY_OFFSET),
    )
)
# A record's head with a length below 2^32. Kinds that also stand inside chunks match only in files without chunks.
_ANY: Final = re.compile(rb"(?=[\x02-\x0f][\s\S]{4}\0{4})")
_OUTSIDE: Final = re.compile(rb"(?=[\x02\x06-\x0f][\s\S]{4}\0{4})")
_OF_CHUNKS: Final = (Kind.CHUNK, Kind.MESSAGE_INDEX)


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


def places(file: ByteFile, name: str, summary: Summary | None) -> Iterator[Place | Damage]:
    """Every record of the data section, and the damage, in the order of the file.

    After damage, continue at the next record, at the next chunk in the file's own index, or at the next bytes that form
    a record. In a truncated file, the torn record at the end is not damage.

    Parameters
    ----------
    file : ByteFile
    name : str
        The file's name, fit for a line.
    summary : Summary or None
    """
    at = len(MAGIC)
    is_whole = file.block(max(0, file.size - len(MAGIC)), len(MAGIC)) == MAGIC
    end = summary.begin if summary is not None else file.size - len(MAGIC) * is_whole
    in_chunks = True if summary is not None and summary.in_chunks else None
    passed_over = 0
    if file.at(0, len(MAGIC)) != MAGIC:
        yield _damage(name, 0, len(MAGIC), "no MCAP file starts with them")
    while at < end:
        head = file.head(at)
        if head is not None and file.is_sound(at):
            place = Place(head[0], at + HEAD.size, head[1])
            if place.kind in _END:
                return
            in_chunks = True if place.kind == Kind.CHUNK else in_chunks
            yield place
            at = place.end
            continue
        if head is not None and _is_private(file, at, head, summary):
            at += HEAD.size + head[1]
            continue
        if file.at(at, 1)[0] == Kind.CHUNK:
            in_chunks = True
        if in_chunks is None:  # searched once, because this may scan the whole file
            chunk = _found(file, at + 1, end, _OUTSIDE)
            in_chunks = chunk is not None and file.at(chunk, 1)[0] in _OF_CHUNKS
        following = _following(file, at, end, in_chunks, summary)
        if following is None and not is_whole:
            return  # torn here
        passed_over += 1
        if passed_over > _PASSED_OVER_MAX:
            following = None
        at, begin = end if following is None else following, at
        yield _damage(name, begin, at, "no record of the stated length begins there")


def _damage(name: str, begin: int, end: int, why: str) -> Damage:
    return Damage(DecodeError(f"{name}: skipping the damaged bytes {begin} to {end}: {why}"))


def _is_private(file: ByteFile, at: int, head: tuple[int, int], summary: Summary | None) -> bool:
    """Whether to skip an unknown kind as private; needs message counts, which reveal a message lost this way."""
    if summary is None or not summary.counts or head[0] <= max(Kind):
        return False
    is_indexed = bisect_right(summary.starts, at) > bisect_right(summary.starts, at - 1)
    return not is_indexed and file.begins_record(at + HEAD.size + head[1])


def _following(file: ByteFile, at: int, end: int, in_chunks: bool, summary: Summary | None) -> int | None:
    """The first byte of the next sound record after a damaged one; None if there is none."""
    if (head := file.head(at)) is not None:
        behind = at + HEAD.size + head[1]
        if behind < end and file.is_sound(behind):
            return behind
    if summary is not None:
        first = bisect_right(summary.starts, at)
        for start in summary.starts[first : first + _INDEXED_MAX]:
            if file.is_sound(start):
                return int(start)
    return _found(file, at + 1, end, _OUTSIDE if in_chunks else _ANY)


def _found(file: ByteFile, begin: int, end: int, head: re.Pattern[bytes]) -> int | None:
    """The first place of a sound record with something like a record after it; None if there is none."""
    while begin < end:
        block = file.block(begin, min(_SCAN_BYTES, end - begin))
        # A power cut can leave many zeros, at which no record begins.
        for match in head.finditer(block) if block.count(0) < len(block) else ():
            at = begin + match.start()
            found = file.head(at)
            if found is not None and file.is_sound(at) and file.begins_record(at + HEAD.size + found[1]):
                return at
        if len(block) <= HEAD.size:
            return None
        begin += len(block) - HEAD.size + 1
    return None
