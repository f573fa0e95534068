"""Control over the freed memory that the C library keeps."""

from __future__ import annotations

import ctypes

# From glibc's malloc.h.
_M_ARENA_MAX = -8


def return_free_memory() -> None:
    """Return freed memory to the system, within milliseconds: glibc keeps what lies below the
    newest block, most of a large map.
    """
    # Only glibc has these functions.
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def share_free_memory() -> None:
    """Make threads that start later allocate from one heap:
    by default glibc gives each its own, with 2 MB unused.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, 1)
