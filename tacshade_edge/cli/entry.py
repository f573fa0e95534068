"""The process around a command: stopped before it has begun, and ended with its exit code whatever is left of it."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
from types import TracebackType
from typing import NoReturn

from tacshade_edge.cli import EXIT_FAILED, EXIT_OK, main


def entry() -> NoReturn:
    """Be the console script and ``python -m tacshade_edge``."""
    if sys.argv[1:2] == ["run"]:
        # Its imports take seconds on a small board; until the daemon is there, a stop has nothing to finish.
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: os._exit(EXIT_OK))
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
