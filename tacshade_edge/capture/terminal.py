"""A dialogue in lines during other work: only `wait` waits for the person."""

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
    """The person ended the dialogue (Ctrl-D), or the pipe in place of a person has closed."""


class Terminal:
    """A terminal that reads lines from a file descriptor and writes lines to a stream. `descriptor`: source of the
    lines, such as standard input.
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
        """Within this context, any key counts as a line; keys typed before are discarded."""
        before = termios.tcgetattr(self._descriptor) if os.isatty(self._descriptor) else None
        if before is not None:
            tty.setcbreak(self._descriptor)  # discards unread input
        self._keys, self._typed = True, b""
        try:
            yield
        finally:
            self._keys, self._typed = False, b""
            if before is not None:
                termios.tcsetattr(self._descriptor, termios.TCSAFLUSH, before)

    def line(self) -> str | None:
        """Return the next typed line, stripped; None if there is none yet. Raises InputEnded."""
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
        """Wait for the next line and return it; nothing else runs meanwhile. Raises InputEnded."""
        while (line := self.line()) is None:
            select.select([self._descriptor], [], [])
        return line

    def say(self, text: str) -> None:
        """Print a line; it replaces one printed by `show`."""
        print(f"{_CLEAR if self._shown else ''}{text}", file=self._out, flush=True)
        self._shown = ""

    def ask(self, text: str) -> None:
        """Print a prompt for the person's line."""
        print(f"{_CLEAR if self._shown else ''}{text} ", end="", file=self._out, flush=True)
        self._shown = ""

    def show(self, text: str) -> None:
        """Show a line that the next one replaces; only if the output is a terminal."""
        if self._is_live and text != self._shown:
            print(f"{_CLEAR}{text[: self._columns() - 1]}", end="", file=self._out, flush=True)
            self._shown = text

    def _columns(self) -> int:
        try:
            return os.get_terminal_size(self._out.fileno()).columns or 80
        except OSError:
            return 80
