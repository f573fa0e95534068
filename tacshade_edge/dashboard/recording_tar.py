"""A recording as a tar file whose bytes are known by their place, so that a download can resume."""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import tarfile
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tacshade_edge.errors import DeviceError

CHUNK_BYTES: Final = 1 << 16


@dataclass(frozen=True, slots=True)
class Tar:
    """The files of a recording at one time, each after its header; `etag` changes with any."""

    folder: Path
    files: tuple[tuple[str, bytes, int], ...]  # name, header, bytes
    size_bytes: int
    etag: str

    def pieces(self, start: int = 0, stop: int | None = None) -> Generator[bytes, None, None]:
        """The bytes from `start` to before `stop`, in pieces.

        Raises DeviceError if a file is unreadable or shorter than it was.
        """
        stop = self.size_bytes if stop is None else min(stop, self.size_bytes)
        at = 0
        for name, header, size in self.files:
            yield from _cut(header, at, start, stop)
            at += len(header)
            if size and at < stop and at + size > start:
                yield from self._content(name, max(start - at, 0), min(stop - at, size))
            at += size
            padding = -size % tarfile.BLOCKSIZE
            yield from _cut(bytes(padding), at, start, stop)
            at += padding
        yield from _cut(bytes(self.size_bytes - at), at, start, stop)

    def _content(self, name: str, start: int, stop: int) -> Iterator[bytes]:
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC
        with errors(f"{name} cannot be read"):
            descriptor = os.open(self.folder / name, flags)
        with open(descriptor, "rb", buffering=0) as stream:
            stream.seek(start)
            while start < stop:
                with errors(f"{name} cannot be read"):
                    piece = stream.read(min(CHUNK_BYTES, stop - start))
                if not piece:
                    raise DeviceError(f"{name} cannot be read: unexpected end of data")
                start += len(piece)
                yield piece


def _cut(piece: bytes, at: int, start: int, stop: int) -> Iterator[bytes]:
    """The part of a piece at a place that lies between `start` and `stop`, if any."""
    if part := piece[max(start - at, 0) : max(stop - at, 0)]:
        yield part


def tar_of(folder: Path) -> Tar:
    """The tar of a recording's regular files. Raises DeviceError."""
    with errors(f"{folder.name} cannot be read"), os.scandir(folder) as entries:
        found = sorted((entry.name, entry.stat(follow_symlinks=False)) for entry in entries)
    files = []
    digest = hashlib.sha256()
    for name, about in found:
        if stat.S_ISREG(about.st_mode):
            info = tarfile.TarInfo(f"{folder.name}/{name}")
            info.size, info.mtime = about.st_size, int(about.st_mtime)
            files.append((name, info.tobuf(tarfile.GNU_FORMAT), info.size))
            digest.update(f"{name}/{info.size}/{about.st_mtime_ns}/".encode(errors="replace"))
    blocks = 2 * tarfile.BLOCKSIZE + sum(
        len(header) + size + -size % tarfile.BLOCKSIZE for _, header, size in files
    )
    whole = -(-blocks // tarfile.RECORDSIZE) * tarfile.RECORDSIZE
    return Tar(folder, tuple(files), whole, f'"{digest.hexdigest()[:32]}"')


@contextlib.contextmanager
def errors(what: str) -> Iterator[None]:
    """Raise a DeviceError that begins with `what` in place of an OSError; a time-out passes."""
    try:
        yield
    except TimeoutError:
        raise
    except OSError as error:
        raise DeviceError(f"{what}: {error.strerror or error}") from error
