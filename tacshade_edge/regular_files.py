"""Reads files that somebody else wrote: only regular files,
whose size is known before they are read.
"""

from __future__ import annotations

import codecs
import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, Final

_UTF_16: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def open_regular(path: str | os.PathLike[str], bytes_max: int) -> BinaryIO:
    """Open a file for reading; refuse a pipe, a device or a folder before it can hang or never end.

    `bytes_max`: greatest accepted size. Raises OSError (the file is absent, unreadable, not a
    regular file, or too large; `strerror` says which, in words for a person).
    """
    try:
        # Without O_NONBLOCK, opening a pipe would wait for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:
        # A NUL in the name.
        raise OSError(errno.EINVAL, str(error), path) from None
    # Of what was opened: a path may be another file a moment later.
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        folder = stat.S_ISDIR(status.st_mode)
        raise OSError(
            errno.EINVAL, os.strerror(errno.EISDIR) if folder else "found no regular file", path
        )
    if status.st_size > bytes_max:
        os.close(descriptor)
        raise OSError(errno.EFBIG, f"found more than {bytes_max} bytes", path)
    return os.fdopen(descriptor, "rb")


def read_regular(path: str | os.PathLike[str], bytes_max: int) -> bytes:
    """Read a file, up to its size when it was opened. Raises OSError like `open_regular`."""
    with open_regular(path, bytes_max) as stream:
        # Up to the size that was checked: the file may grow meanwhile.
        return stream.read(os.fstat(stream.fileno()).st_size)


def decoded(data: bytes) -> str:
    """The text of a file that a person wrote: UTF-8, or UTF-16 with its byte order mark, which
    editors of Windows begin a file with and which is no part of the text.

    Raises UnicodeDecodeError.
    """
    return data.decode("utf-16" if data[:2] in _UTF_16 else "utf-8-sig")


def named_file(folder: Path, name: str) -> Path:
    """The path of a file that a table or settings file names:
    relative to its folder, from ``~``, or as in Windows.
    """
    path = folder / os.path.expanduser(name)
    # Tables are often written on Windows; on Linux such a name may be a file's own.
    return folder / name.replace("\\", "/") if "\\" in name and not path.exists() else path
