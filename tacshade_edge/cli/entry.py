"""The process around a command: refuses limits that are too low, and exits with the command's code in any case."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import resource
import sys
import threading
from types import TracebackType
from typing import NoReturn

from tacshade_edge.cli import EXIT_CONFIG, EXIT_FAILED, main

# Libraries and the threads' stacks and heaps reserve it; most is never used. With less, OpenCV crashes with a
# segmentation fault as it is loaded, or OpenBLAS ends the process later.
ADDRESS_SPACE_BYTES_MIN = 1 << 30

# The supervisor of a hand with 16 sensors and a robot opens about 100 files.
OPEN_FILES_MIN = 128


def entry() -> NoReturn:
    """Run the command line and exit; ``tacshade_edge.__main__`` sets up the signals."""
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
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a path may not be UTF-8
    sys.excepthook = _defect
    leave(main())


def leave(code: int) -> NoReturn:
    """End the process with this exit code.

    A thread may still run: slowly, or in a driver that hangs. When the interpreter shuts down, CPython ends such a
    thread with ``pthread_exit`` as soon as it next requests the interpreter's lock; C++ libraries then abort the
    process, whose exit code becomes SIGABRT's. So the interpreter shuts down only if no other thread is left.
    """
    _end_if_threads_are_left(code)
    sys.exit(code)


def _defect(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Handle an uncaught error: print a traceback and exit with 1, which Python does by itself if no thread is left."""
    sys.__excepthook__(kind, error, trace)
    _end_if_threads_are_left(EXIT_FAILED)


def _end_if_threads_are_left(code: int) -> None:
    if threading.active_count() == 1:
        return
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # the stream is closed, or its reader is
            stream.flush()
    os._exit(code)
