"""The progress of a long command on stderr: a line that updates itself on a terminal,
a line every 10 s elsewhere.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import Final, TextIO

PERIOD_S: Final = 10.0
_TERMINAL_PERIOD_S: Final = 0.1
# From here on nobody needs the seconds.
_MINUTES_FROM_S: Final = 90.0
# So much work has to be done before its speed says something of the rest.
_ESTIMATE_AFTER_S: Final = 1.0


class Progress:
    """Shows how many items are done, of how many, and the remaining time at the mean speed so far
    (on stderr).
    """

    def __init__(
        self, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._stream = stream or sys.stderr
        self._clock = clock
        self._live = self._stream.isatty()
        self._what = ""
        self._began_s = self._said_s = clock()
        # The terminal's line has not ended yet.
        self._is_open = False

    def __call__(self, what: str, done: int, total: int | None) -> None:
        """Report progress if it is time to; a different name
        of the counted items starts a new count.
        """
        now_s = self._clock()
        if what != self._what:
            self.end()
            self._what, self._began_s = what, now_s
            # A terminal shows the first count at once; a log gets a line only from work that takes
            # longer than a period.
            self._said_s = -math.inf if self._live else now_s
        # The last count replaces an older one on the terminal, which would else stay there as if
        # the work had stopped.
        is_last = done == total
        if now_s - self._said_s < (_TERMINAL_PERIOD_S if self._live else PERIOD_S) and not (
            is_last and self._is_open
        ):
            return
        self._said_s = now_s
        text = f"{what}: {done}" + ("" if total is None else f"/{total}")
        passed_s = now_s - self._began_s
        if total and done and passed_s > _ESTIMATE_AFTER_S:
            left_s = passed_s * (total - done) / done
            text += (
                f", {left_s:.0f} s left"
                if left_s < _MINUTES_FROM_S
                else f", {left_s / 60:.0f} min left"
            )
        if not self._live:
            print(text, file=self._stream, flush=True)
            return
        # Back to the line's start and erase it: the new text may be shorter than the old one.
        print(f"\r\033[K{text}", end="", file=self._stream, flush=True)
        self._is_open = True
        if is_last:
            self.end()

    def warn(self, line: object) -> None:
        """Write a separate line in place of the one that updates itself."""
        start = "\r\033[K" if self._is_open else ""
        print(f"{start}tacshade-edge: {line}", file=self._stream, flush=True)
        self._is_open = False

    def end(self) -> None:
        if self._is_open:
            print(file=self._stream, flush=True)
            self._is_open = False
