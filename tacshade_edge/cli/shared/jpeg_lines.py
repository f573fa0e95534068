"""What libjpeg and libpng write about odd pictures, as log messages: some cameras damage each picture a little.

OpenCV offers no handler for it: they write each line with C's `stderr`, so this replaces that stream.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import logging
import os
from typing import Any

_log = logging.getLogger(__name__)

_UNBUFFERED = 2  # _IONBF
_FILENO_AT = 14 * ctypes.sizeof(ctypes.c_void_p)
"""Offset of `_fileno` in glibc's ``struct _IO_FILE``: Python's fatal errors are written to C's ``fileno(stderr)``."""


def _write(_cookie: int | None, data: int, size: int) -> int:
    for line in ctypes.string_at(data, size).splitlines(keepends=True):
        if b"JPEG" in line or line.startswith(b"libpng"):
            _log.warning("%s%s", "libjpeg: " * (b"JPEG" in line), line.decode(errors="replace").strip())
        else:
            with contextlib.suppress(OSError):
                os.write(2, line)
    return size


_Write = ctypes.CFUNCTYPE(ctypes.c_ssize_t, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)
_write_from_c = _Write(_write)


class _Functions(ctypes.Structure):
    """``cookie_io_functions_t``."""

    _fields_ = (("read", ctypes.c_void_p), ("write", _Write), ("seek", ctypes.c_void_p), ("close", ctypes.c_void_p))


_stream: list[int] = []


def log_jpeg_lines() -> None:
    """Log what they write from now on; what other C code writes goes to stderr as before. Needs glibc."""
    if _stream or not _is_glibc():
        return
    libc: Any = ctypes.CDLL(None)
    libc.fopencookie.restype = ctypes.c_void_p
    libc.fopencookie.argtypes = (ctypes.c_void_p, ctypes.c_char_p, _Functions)
    libc.setvbuf.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t)
    libc.fileno.argtypes = (ctypes.c_void_p,)
    stderr = ctypes.c_void_p.in_dll(libc, "stderr")
    before, stream = stderr.value, libc.fopencookie(None, b"w", _Functions(None, _write_from_c, None, None))
    if before is None or not stream:
        return
    number = ctypes.c_int.from_address(before + _FILENO_AT)
    if number.value != libc.fileno(stderr):
        return
    libc.setvbuf(stream, None, _UNBUFFERED, 0)
    ctypes.c_int.from_address(stream + _FILENO_AT).value = number.value
    atexit.register(setattr, stderr, "value", before)  # nothing may call Python after its end
    stderr.value = stream
    _stream.append(stream)


def _is_glibc() -> bool:
    with contextlib.suppress(ValueError, OSError):
        return bool(os.confstr("CS_GNU_LIBC_VERSION"))
    return False
