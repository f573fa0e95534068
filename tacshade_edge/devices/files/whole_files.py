"""Files that are there whole or not at all, and the one line that says why one could not be written."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from tacshade_edge.errors import DeviceError
from tacshade_edge.reasons import ReasonCode


@contextlib.contextmanager
def disk_errors(folder: Path) -> Iterator[None]:
    """Turn an OSError into a DeviceError that names the file, or the folder where no file is known."""
    try:
        yield
    except OSError as error:
        where = error.filename or folder
        raise DeviceError(f"{where}: cannot be written: {error.strerror or error}", code=ReasonCode.DISK) from None


def part(path: Path) -> Path:
    """Where a file is while it is not whole."""
    return path.with_name(path.name + ".part")


def write_whole(path: Path, data: bytes, *, sync: bool = True) -> None:
    """Write beside the place, and rename. Raises OSError, and nothing is left then.

    Parameters
    ----------
    path : Path
    data : bytes
    sync : bool
        Wait for the disk; False for one of many, which `sync` is called for later.
    """
    partial = part(path)
    try:
        with partial.open("wb") as stream:
            stream.write(data)
            if sync:
                stream.flush()
                os.fsync(stream.fileno())
        os.replace(partial, path)
    except OSError:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def sync(path: Path) -> None:
    """Wait until the disk has a file's bytes, or a folder's names. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
