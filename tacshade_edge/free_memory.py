"""Control over the freed memory that the C library keeps."""

from __future__ import annotations

import contextlib
import ctypes
from pathlib import Path

_M_ARENA_MAX = -8  # glibc's malloc.h
_MADV_DONTNEED = 4  # Linux's mman.h


def return_free_memory() -> None:
    """Return freed memory to the system, within milliseconds: glibc keeps what lies below the newest block, most of a
    large map.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def share_free_memory() -> None:
    """Make threads that start later allocate from one heap: by default glibc gives each its own, with 2 MB unused."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, 1)


def drop_unused_code() -> None:
    """Unmap the libraries' code, of which the start needs most: what still runs is mapped again when it does, a page
    fault for each 64 kB, and the kernel may drop the rest.
    """
    with contextlib.suppress(OSError, AttributeError):  # not on Linux
        madvise = ctypes.CDLL(None).madvise
        for line in Path("/proc/self/maps").read_text().splitlines():
            place, access, *_, path = line.split(maxsplit=5)
            if access == "r-xp" and path.startswith("/"):  # nothing is ever written there
                start, end = (int(address, 16) for address in place.split("-"))
                madvise(ctypes.c_void_p(start), ctypes.c_size_t(end - start), _MADV_DONTNEED)
