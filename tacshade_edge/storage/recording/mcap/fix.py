"""Fixes MCAP files after a crash of their writer: truncates each after its last whole record and ends it."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import BinaryIO, Final

from tacshade_edge.errors import DeviceError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.storage.atomic_files import sync
from tacshade_edge.storage.recording.mcap.layout import HEAD, MAGIC, ByteFile, Kind
from tacshade_edge.storage.recording.mcap.walk import Place, places

# The end of a data section without a checksum, and no summary, so readers scan the file.
_END: Final = HEAD.pack(Kind.DATA_END, 4) + bytes(4) + HEAD.pack(Kind.FOOTER, 20) + bytes(20) + MAGIC
_SUFFIX: Final = ".mcap.part"


def fix_recordings(folder: Path) -> list[Path]:
    """Fix every recording below `folder` that nobody is writing.

    Returns
    -------
    list of Path
        The new names of the fixed files.

    Raises
    ------
    DeviceError
        The disk fails; files not yet fixed are unchanged.
    """
    try:
        found = (fix(path) for path in sorted(folder.glob(f"*/*{_SUFFIX}")))
        return [path for path in found if path is not None]
    except OSError as error:
        where = error.filename or folder
        raise DeviceError(
            f"{where}: cannot repair the recording: {error.strerror or error}", code=ReasonCode.DISK
        ) from None


def fix(path: Path) -> Path | None:
    """Turn ``NAME.mcap.part`` into ``NAME.mcap``; return None if somebody is writing it or it lacks a header.

    Raises OSError.
    """
    with path.open("r+b") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return None
        if (end := _end_of_records(stream)) is None:
            return None
        stream.truncate(end)
        stream.seek(end)
        stream.write(_END)
        stream.flush()
        os.fsync(stream.fileno())
        whole = path.with_name(path.name.removesuffix(".part"))
        path.rename(whole)
        sync(path.parent)
    return whole


def _end_of_records(stream: BinaryIO) -> int | None:
    """The end of the last whole record in the data section, past any damage, which readers will report."""
    file = ByteFile(stream)
    if file.at(0, len(MAGIC)) != MAGIC:
        return None
    return max((place.end for place in places(file, "", None) if isinstance(place, Place)), default=None)
