"""The one door for files that somebody else wrote: regular files only, of a size that is known before they are read."""

from __future__ import annotations

import errno
import os
import stat
from typing import BinaryIO


def open_regular(path: str | os.PathLike[str], bytes_max: int) -> BinaryIO:
    """Open a file for reading; a pipe, a device or a folder is refused before it can hang or go on for ever.

    Parameters
    ----------
    path : path
    bytes_max : int
        The file is refused when it is larger.

    Raises
    ------
    OSError
        Not there, not readable, no regular file, or too large; `strerror` says which, fit for a person.
    """
    try:
        # A pipe without a writer would wait for one.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:  # a NUL in the name
        raise OSError(errno.EINVAL, str(error), path) from None
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        folder = stat.S_ISDIR(status.st_mode)
        raise OSError(errno.EINVAL, os.strerror(errno.EISDIR) if folder else "found no regular file", path)
    if status.st_size > bytes_max:
        os.close(descriptor)
        raise OSError(errno.EFBIG, f"found more than {bytes_max} bytes", path)
    return os.fdopen(descriptor, "rb")


def read_regular(path: str | os.PathLike[str], bytes_max: int) -> bytes:
    """Read a whole file, of what it is when it is opened. Raises OSError as `open_regular`."""
    with open_regular(path, bytes_max) as stream:
        return stream.read(os.fstat(stream.fileno()).st_size)
