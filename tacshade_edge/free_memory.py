"""What the process freed, given back to the system."""

from __future__ import annotations

import ctypes


def return_free_memory() -> None:
    """Give it back now: glibc keeps what lies below the newest block, of a large map most of it.

    Takes some milliseconds, during which other threads go on. Another C library has nothing to be asked.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
