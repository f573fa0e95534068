"""A dialogue in lines while something else goes on: nothing here waits for the person."""

from __future__ import annotations

import contextlib
import os
import select
import termios
import tty
from collections.abc import Iterator
from typing import Final, TextIO

_CLEAR: Final = "\r\x1b[K"


class InputEnded(Exception):
    """The person ended the dialogue (Ctrl-D), or the pipe that speaks for one."""


class Terminal:
    """Lines from a file descriptor, lines to a stream.

    Parameters
    ----------
    descriptor : int
        In place of standard input.
    out : TextIO
    """

    def __init__(self, descriptor: int, out: TextIO) -> None:
        self._descriptor = descriptor
        self._out = out
        self._is_live = out.isatty()
        self._typed = b""
        self._shown = ""
        self._keys = False

    @contextlib.contextmanager
    def keys(self) -> Iterator[None]:
        """Within this, any key is a line of its own, and what was typed before is forgotten."""
        before = termios.tcgetattr(self._descriptor) if os.isatty(self._descriptor) else None
        if before is not None:
            tty.setcbreak(self._descriptor)  # forgets what waits to be read
        self._keys, self._typed = True, b""
        try:
            yield
        finally:
            self._keys, self._typed = False, b""
            if before is not None:
                termios.tcsetattr(self._descriptor, termios.TCSAFLUSH, before)

    def line(self) -> str | None:
        """A line that was typed meanwhile, stripped; None while there is none. Raises InputEnded."""
        if b"\n" not in self._typed and select.select([self._descriptor], [], [], 0)[0]:
            data = os.read(self._descriptor, 4096)
            if not data:
                raise InputEnded
            self._typed += data
        line, end, rest = self._typed.partition(b"\n")
        if not end and not (self._keys and line):
            return None
        self._typed, self._shown = rest, ""
        return line.decode(errors="replace").strip()

    def wait(self) -> str:
        """The next line, where nothing else goes on. Raises InputEnded."""
        while (line := self.line()) is None:
            select.select([self._descriptor], [], [])
        return line

    def say(self, text: str) -> None:
        """Print a line, in place of a passing one."""
        print(f"{_CLEAR if self._shown else ''}{text}", file=self._out, flush=True)
        self._shown = ""

    def ask(self, text: str) -> None:
        """Print what stands before the person's line."""
        print(f"{_CLEAR if self._shown else ''}{text} ", end="", file=self._out, flush=True)
        self._shown = ""

    def show(self, text: str) -> None:
        """Show a line that the next takes the place of; only where a person looks."""
        if self._is_live and text != self._shown:
            print(f"{_CLEAR}{text[: self._columns() - 1]}", end="", file=self._out, flush=True)
            self._shown = text

    def _columns(self) -> int:
        try:
            return os.get_terminal_size(self._out.fileno()).columns or 80
        except OSError:
            return 80
