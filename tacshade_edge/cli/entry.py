"""The process around a command: refused where it cannot work, and ended with its exit code whatever is left of it."""

from __future__ import annotations

import contextlib
import logging
import os
import resource
import sys
import threading
from types import TracebackType
from typing import NoReturn

from tacshade_edge.cli import EXIT_CONFIG, EXIT_FAILED, main

# Most of it is never used: libraries, and the threads' stacks and heaps. Below, OpenCV ends in a segmentation fault
# while it is loaded, and OpenBLAS ends the process later.
ADDRESS_SPACE_BYTES_MIN = 1 << 30

# A hand of 16 sensors with a robot has about 100 in its supervisor.
OPEN_FILES_MIN = 128


def entry() -> NoReturn:
    """Do what the command line says; the signals are ``tacshade_edge.__main__``'s."""
    limit_bytes, _ = resource.getrlimit(resource.RLIMIT_AS)
    if 0 <= limit_bytes < ADDRESS_SPACE_BYTES_MIN:
        found = f"found {limit_bytes >> 20} MiB of address space (ulimit -v, RLIMIT_AS)"
        print(f"tacshade-edge: {found}, expected at least {ADDRESS_SPACE_BYTES_MIN >> 20} MiB", file=sys.stderr)
        sys.exit(EXIT_CONFIG)
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= limit < OPEN_FILES_MIN:
        found = f"found at most {limit} open files (ulimit -n, RLIMIT_NOFILE)"
        print(f"tacshade-edge: {found}, expected at least {OPEN_FILES_MIN}", file=sys.stderr)
        sys.exit(EXIT_CONFIG)
    sys.excepthook = _defect
    leave(main())


def leave(code: int) -> NoReturn:
    """End the process with this exit code.

    A thread may be left: in a driver that hangs, or just slow. CPython tears such a thread out of the library that it
    is in (``pthread_exit``, when it next asks for the interpreter's lock), C++ libraries end the process for that, and
    the exit code would be SIGABRT's. So the interpreter is taken down only when no other thread is left.
    """
    _end_if_threads_are_left(code)
    sys.exit(code)


def _defect(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """What ends a process that nothing caught: a traceback and exit 1, which come of themselves without threads."""
    sys.__excepthook__(kind, error, trace)
    _end_if_threads_are_left(EXIT_FAILED)


def _end_if_threads_are_left(code: int) -> None:
    if threading.active_count() == 1:
        return
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # its reader is gone, or it is closed
            stream.flush()
    os._exit(code)
