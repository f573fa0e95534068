"""The process around a command: refuses limits that are too low,
and exits with the command's code in any case.
"""

from __future__ import annotations

import contextlib
import logging
import os
import resource
import sys
import threading
import traceback
from types import TracebackType
from typing import NoReturn

from tacshade_edge.cli import EXIT_CONFIG, EXIT_FAILED, main
from tacshade_edge.cli.shared.journal import complain, is_journal
from tacshade_edge.cli.streams import STDOUT, flush_stdout, prepare_streams

# With less address space, most of which is never used, OpenCV crashes as it is loaded, or OpenBLAS
# ends the process later. The supervisor of a hand with 16 sensors and a robot opens about 100
# files.
LIMITS = (
    (resource.RLIMIT_AS, 1 << 30, 20, "MiB of address space (ulimit -v, RLIMIT_AS)"),
    (resource.RLIMIT_NOFILE, 128, 0, "open files (ulimit -n, RLIMIT_NOFILE)"),
)


def entry() -> NoReturn:
    """Run the command line and exit; ``tacshade_edge.__main__`` sets up the signals."""
    prepare_streams()
    for limit, least, shift, what in LIMITS:
        found, _ = resource.getrlimit(limit)
        if 0 <= found < least:
            text = f"found at most {found >> shift} {what}, expected at least {least >> shift}"
            complain(f"tacshade-edge: {text}")
            sys.exit(EXIT_CONFIG)
    sys.excepthook = _defect
    try:
        code = main()
    except SystemExit as end:  # argparse's, which has printed help or a mistake
        code = end.code if isinstance(end.code, int) else EXIT_FAILED
    leave(_printed(code))


def _printed(code: int) -> int:
    """The exit code, once what was printed is written."""
    try:
        flush_stdout()
    except BrokenPipeError:
        return EXIT_FAILED
    except OSError as error:
        complain(f"tacshade-edge: {STDOUT}: {error.strerror}")
        return EXIT_FAILED
    return code


def leave(code: int) -> NoReturn:
    """End the process with this exit code, though a thread may still run:
    slowly, or in a driver that hangs.

    CPython ends such a thread with ``pthread_exit``, for which C++ libraries abort the process, so
    the interpreter shuts down only if no other thread is left.
    """
    _end_if_threads_are_left(code)
    sys.exit(code)


def _defect(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Handle an uncaught error: print a traceback and exit with 1,
    which Python does by itself if no thread is left.
    """
    if is_journal():
        complain("".join(traceback.format_exception(kind, error, trace)).rstrip())
    else:
        sys.__excepthook__(kind, error, trace)
    _end_if_threads_are_left(EXIT_FAILED)


def _end_if_threads_are_left(code: int) -> None:
    if threading.active_count() == 1:
        return
    # os._exit skips all that the interpreter does at its end: what is buffered would be lost.
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        # The stream is closed, or its reader is.
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)
