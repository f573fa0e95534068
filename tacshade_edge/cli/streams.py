"""The process's standard streams: an error of theirs has a name, and one that is missing or full
ends no work but its own.
"""

from __future__ import annotations

import contextlib
import io
import os
import select
import sys
from typing import Final

STDOUT: Final = "standard output"
"""How errors name it, where others name a file."""


class _Waiting(io.FileIO):
    """A stream that waits for room, also where another program (Node.js, ssh) has made it
    non-blocking.
    """

    def write(self, data: object, /) -> int:
        while (written := super().write(data)) is None:  # type: ignore[arg-type]
            select.select((), (self,), ())
        return int(written)


class _Named(_Waiting):
    """A stream whose errors name it."""

    def write(self, data: object, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            error.filename = STDOUT
            raise


class _Forgiving(_Waiting):
    """A stream that loses what nobody can take: a log on a full disk must not end hours of work."""

    def write(self, data: object, /) -> int:
        with contextlib.suppress(OSError):
            return super().write(data)
        return len(memoryview(data))  # type: ignore[arg-type]


def prepare_streams() -> None:
    """Give the process a stdout whose errors have a name, and a stderr that has none."""
    sys.stdout = _text(_Named(1, "w", closefd=False), "backslashreplace")
    sys.stderr = _text(_Forgiving(2, "w", closefd=False), "backslashreplace", lines=True)


def flush_stdout() -> None:
    """Write what is buffered. Raises OSError, after which nothing is left to be written."""
    try:
        sys.stdout.flush()
    except OSError:
        drop_stdout()
        raise


def drop_stdout() -> None:
    """Let what is still printed go nowhere, so that the interpreter's end does not fail at it."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.close(null)


def _text(raw: io.FileIO, errors: str, *, lines: bool = False) -> io.TextIOWrapper:
    # A path may hold bytes that are not UTF-8, at which print() would fail.
    encoding = getattr(sys.__stdout__, "encoding", None) or "utf-8"
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=encoding,
        errors=errors,
        line_buffering=lines or raw.isatty(),
    )
