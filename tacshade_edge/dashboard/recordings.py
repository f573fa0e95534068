"""The recordings in one folder: listed, sent as a tar, deleted. Names come from whoever opened the page."""

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
"""A recording that has no end yet and grew so recently is still being written."""
_CHUNK_BYTES: Final = 1 << 18
_BLOCK: Final = tarfile.BLOCKSIZE
_NAME: Final = re.compile(RECORD_NAME)


@dataclass(frozen=True, slots=True)
class Listed:
    """One recording of the list.

    Attributes
    ----------
    name : str
        As the other functions take it: ``NAME``, or ``SENSOR/NAME`` of several sensors.
    frames, size_bytes : int or None
        None where its writer has not ended it.
    began_ns : int
        Unix time of its first frame, or of its folder.
    is_growing : bool
        It is still being written.
    """

    name: str
    frames: int | None
    size_bytes: int | None
    began_ns: int
    is_growing: bool

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def listed(folder: Path) -> list[Listed]:
    """The newest recordings of a folder and of the folders in it, the newest first, at most `LISTED_MAX`.

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
    """The recording of this name.

    Raises
    ------
    DeviceError
        No name of a recording, no recording, one that is still being written, or a link out of the folder.
    """
    parts = name.split("/") if isinstance(name, str) else []
    if not 1 <= len(parts) <= 2 or not all(_NAME.match(part) for part in parts):
        raise DeviceError(f"found the name {shown(str(name))}, expected one from the list")
    path = folder
    for part in parts:
        path /= part
        if path.is_symlink():
            raise DeviceError(f"{shown(str(name))} is a link, expected a recording")
    if not _is_recording(path):
        raise DeviceError(f"found no recording {shown(str(name))}")
    if _look_at(folder, "/".join(parts)).is_growing:
        raise DeviceError(f"{shown(str(name))} is still being written")
    return path


def delete(path: Path) -> None:
    """Delete what `find` found.

    Raises
    ------
    DeviceError
        The system does not allow it; a part may be gone.
    """
    try:
        shutil.rmtree(path)
    except OSError as error:
        raise DeviceError(f"{path.name} cannot be deleted: {error.strerror or error}") from error


def tar_bytes(path: Path) -> int:
    """How many bytes `tar` gives, as long as nothing changes. Raises DeviceError."""
    return sum(_BLOCK + _padded(size) for _, size, _ in _files(path)) + 2 * _BLOCK


def tar(path: Path) -> Iterator[bytes]:
    """The regular files of a recording as an uncompressed tar, in pieces; links in it are left out.

    Raises
    ------
    DeviceError
        A file cannot be read, or became shorter.
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
    """The regular files, in order: path, bytes, time of change."""
    try:
        with os.scandir(path) as entries:
            found = [(Path(entry.path), entry.stat(follow_symlinks=False)) for entry in entries]
    except OSError as error:
        raise DeviceError(f"{path.name} cannot be read: {error.strerror or error}") from error
    return sorted((file, about.st_size, about.st_mtime) for file, about in found if stat.S_ISREG(about.st_mode))


def _names(folder: Path) -> list[str]:
    """Folders that a recording can be called as; never links."""
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
        changed_s = 0.0  # it was deleted meanwhile
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
