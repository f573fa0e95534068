"""List, archive and delete the recordings in one folder. Their names come from the page, so they are untrusted."""

from __future__ import annotations

import json
import os
import re
import shutil
import stat
import tarfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from tacshade_edge.errors import DeviceError
from tacshade_edge.protocol.requests import RECORD_NAME
from tacshade_edge.quoting import shown
from tacshade_edge.regular_files import read_regular

LISTED_MAX: Final = 200
_LOOKED_AT_MAX: Final = 2000
_ABOUT: Final = "recording.json"
_SIGNS: Final = (_ABOUT, "frames.csv", "frames.csv.part", "000.mcap", "000.mcap.part")
_ABOUT_BYTES_MAX: Final = 1 << 20
_STILL_S: Final = 10.0
"""An unfinished recording that grew within this time (s) is still being written."""
_CHUNK_BYTES: Final = 1 << 18
_BLOCK: Final = tarfile.BLOCKSIZE
_NAME: Final = re.compile(RECORD_NAME)


@dataclass(frozen=True, slots=True)
class Listed:
    """One recording in the list.

    Attributes
    ----------
    name : str
        Name for `find`: ``NAME``, or ``SENSOR/NAME`` with several sensors.
    frames, size_bytes : int or None
        None if its writer has not finished it.
    began_ns : int
        Unix time of its first frame, or else of its last change.
    is_growing : bool
        Whether it is still being written.
    """

    name: str
    frames: int | None
    size_bytes: int | None
    began_ns: int
    is_growing: bool

    def as_dict(self) -> dict[str, Any]:
        """Return the fields for JSON."""
        return asdict(self)


def listed(folder: Path) -> list[Listed]:
    """List the recordings in a folder and its subfolders, newest first, at most `LISTED_MAX`.

    Raises
    ------
    DeviceError
        The folder cannot be read.
    """
    found = []
    for name in _names(folder):
        if _is_recording(folder / name):
            found.append(_look_at(folder, name))
        elif "/" not in name:
            found += [
                _look_at(folder, f"{name}/{inner}")
                for inner in _names(folder / name)
                if _is_recording(folder / name / inner)
            ]
    return sorted(found, key=lambda recording: -recording.began_ns)[:LISTED_MAX]


def find(folder: Path, name: object) -> Path:
    """Return the path of the recording with this name.

    Raises
    ------
    DeviceError
        The name is invalid, or it names no recording, one that is still being written, or a symbolic link.
    """
    parts = name.split("/") if isinstance(name, str) else []
    if not 1 <= len(parts) <= 2 or not all(_NAME.match(part) for part in parts):
        raise DeviceError(f"found the name {shown(str(name))}, expected the name of a listed recording")
    path = folder
    for part in parts:
        path /= part
        if path.is_symlink():
            raise DeviceError(f"{shown(str(name))}: found a symbolic link, expected a recording's file or folder")
    if not _is_recording(path):
        raise DeviceError(f"found no recording {shown(str(name))}")
    if _look_at(folder, "/".join(parts)).is_growing:
        raise DeviceError(f"{shown(str(name))} is still being written")
    return path


def delete(path: Path) -> None:
    """Delete a recording that `find` returned.

    Raises
    ------
    DeviceError
        The system does not allow it; some files may already be deleted.
    """
    try:
        shutil.rmtree(path)
    except OSError as error:
        raise DeviceError(f"{path.name} cannot be deleted: {error.strerror or error}") from error


def tar_bytes(path: Path) -> int:
    """Return how many bytes `tar` yields if nothing changes. Raises DeviceError."""
    return sum(_BLOCK + _padded(size) for _, size, _ in _files(path)) + 2 * _BLOCK


def tar(path: Path) -> Iterator[bytes]:
    """Yield the regular files of a recording as an uncompressed tar, in pieces, without its links.

    Raises
    ------
    DeviceError
        A file cannot be read, or has shrunk.
    """
    for file, size, mtime_s in _files(path):
        info = tarfile.TarInfo(f"{path.name}/{file.name}")
        info.size, info.mtime = size, int(mtime_s)
        yield info.tobuf(tarfile.GNU_FORMAT)
        left = size
        try:
            with open(os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC), "rb") as stream:
                while left:
                    chunk = stream.read(min(left, _CHUNK_BYTES))
                    if not chunk:
                        raise DeviceError(f"{file.name} shrank while it was being read")
                    left -= len(chunk)
                    yield chunk
        except OSError as error:
            raise DeviceError(f"{file.name} cannot be read: {error.strerror or error}") from error
        yield bytes(_padded(size) - size)
    yield bytes(2 * _BLOCK)


def _padded(size: int) -> int:
    return -(-size // _BLOCK) * _BLOCK


def _files(path: Path) -> list[tuple[Path, int, float]]:
    """Return the regular files in order: path, size in bytes, modification time in s."""
    try:
        with os.scandir(path) as entries:
            found = [(Path(entry.path), entry.stat(follow_symlinks=False)) for entry in entries]
    except OSError as error:
        raise DeviceError(f"{path.name} cannot be read: {error.strerror or error}") from error
    return sorted((file, about.st_size, about.st_mtime) for file, about in found if stat.S_ISREG(about.st_mode))


def _names(folder: Path) -> list[str]:
    """Return the subfolders with a valid name of a recording, without links."""
    try:
        with os.scandir(folder) as entries:
            found = [entry.name for entry in entries if _NAME.match(entry.name) and entry.is_dir(follow_symlinks=False)]
    except OSError as error:
        raise DeviceError(f"{folder}: {error.strerror or error}") from error
    return sorted(found, reverse=True)[:_LOOKED_AT_MAX]


def _is_recording(path: Path) -> bool:
    return any((path / sign).is_file() for sign in _SIGNS)


def _look_at(folder: Path, name: str) -> Listed:
    path = folder / name
    try:
        changed_s = max((path / sign).stat().st_mtime for sign in ("", *_SIGNS) if (path / sign).exists())
    except (OSError, ValueError):
        changed_s = 0.0  # deleted in the meantime
    about: dict[str, Any] = {}
    if is_whole := (path / _ABOUT).is_file():
        try:
            found = json.loads(read_regular(path / _ABOUT, _ABOUT_BYTES_MAX))
            about = found if isinstance(found, dict) else {}
        except (OSError, ValueError, RecursionError):
            about = {}
    began_ns = _count(about.get("first_wall_ns")) or int(changed_s * 1e9)
    is_growing = not is_whole and abs(time.time() - changed_s) < _STILL_S and _is_unfinished(path)
    return Listed(name, _count(about.get("frames")), _count(about.get("bytes")), began_ns, is_growing)


def _is_unfinished(path: Path) -> bool:
    return any((path / sign).exists() for sign in _SIGNS if sign.endswith(".part"))


def _count(value: object) -> int | None:
    return value if isinstance(value, int) and 0 <= value < 1 << 63 else None
