"""What the C library keeps of the memory that the process freed."""

from __future__ import annotations

import ctypes

_M_ARENA_MAX = -8  # glibc's malloc.h


def return_free_memory() -> None:
    """Give it back now: glibc keeps what lies below the newest block, of a large map most of it.

    Takes some milliseconds, during which other threads go on. Another C library has nothing to be asked.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def share_free_memory() -> None:
    """Let all threads allocate from one heap: by itself glibc gives each a heap, of which 2 MB are unused.

    Only threads that start after it are affected. Another C library has nothing to be asked.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, 1)
