"""The log of long-running commands: one line per message, repeated ones limited; text from outside is escaped."""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import re
import sys
import time
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final, TextIO

from tacshade_edge.quoting import escaped

AT_ONCE: Final = 10
PERIOD_S: Final = 10.0
"""Limit on what says the same but for its numbers: AT_ONCE in a burst, then one per PERIOD_S."""

_TEXTS_MAX: Final = 16
_KINDS_MAX: Final = 128
"""Texts that are distinguished, of one format and in all; any further text of a format counts as one until a quiet
text is forgotten."""
_TEXT_CHARS_MAX: Final = 200
_NUMBER: Final = re.compile(r"(?<![\w/.:-])\d+(?:\.\d+)?(?![\w/:-]|\.\d)")

Text = tuple[str, str, str]
"""A logger's name, the format of a message, and what it says."""


def add_verbosity(parser: argparse.ArgumentParser) -> None:
    how, kind = (
        parser.add_mutually_exclusive_group(),
        dict[str, Any](action="store_const", dest="log_level"),
    )
    how.add_argument(
        "-v",
        "--verbose",
        const=logging.DEBUG,
        help="log more detail, to help you find a fault",
        **kind,
    )
    how.add_argument(
        "-q", "--quiet", const=logging.WARNING, help="log warnings and errors only", **kind
    )
    parser.set_defaults(log_level=logging.INFO)


def start_logging(level: int, sensor_id: str = "") -> None:
    """Log to stderr, with time stamps unless the journal adds them and with `sensor_id`, if given, in each line."""
    logging.basicConfig(
        level=level, handlers=[OneLineHandler(stamped=not _is_journal(), of=sensor_id)], force=True
    )
    # At level DEBUG, these libraries would log every packet and its content.
    for name in ("asyncio", "websockets", "paho"):
        logging.getLogger(name).setLevel(max(level, logging.INFO))


def _is_journal() -> bool:
    """Whether stderr goes to journald: systemd names the device and inode of its stream."""
    with contextlib.suppress(OSError, ValueError):
        found = os.fstat(sys.stderr.fileno())
        return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"
    return False


@dataclass(slots=True)
class _Kind:
    free: float
    at_s: float
    left_out: int = 0

    def free_at(self, now_s: float) -> float:
        return min(AT_ONCE, self.free + (now_s - self.at_s) / PERIOD_S)


class Limit:
    """Decides which messages are too many. Not thread-safe: its handler's lock guards it."""

    def __init__(self) -> None:
        self._kinds: dict[Text, _Kind] = {}

    def passes(self, text: Text, now_s: float) -> bool:
        """Whether to log one more message that says this; if not, count it as left out."""
        name, form, _ = text
        if self._is_too_many(text):
            kept = {
                key: kind
                for key, kind in self._kinds.items()
                if kind.left_out or kind.free_at(now_s) < AT_ONCE
            }
            self._kinds = kept
        if self._is_too_many(text):
            text = (name, form, form)
        key = text if text in self._kinds or len(self._kinds) < 2 * _KINDS_MAX else ("", "", "")
        kind = self._kinds.setdefault(key, _Kind(AT_ONCE, now_s))
        kind.free, kind.at_s = kind.free_at(now_s), now_s
        if kind.free < 1:
            kind.left_out += 1
            return False
        kind.free -= 1
        return True

    def _is_too_many(self, text: Text) -> bool:
        if text in self._kinds:
            return False
        return (
            len(self._kinds) >= _KINDS_MAX
            or sum(key[:2] == text[:2] for key in self._kinds) >= _TEXTS_MAX
        )

    def take_left_out(
        self, now_s: float, *, all_of_them: bool = False
    ) -> list[tuple[str, str, int]]:
        """Return and reset the counts of left-out messages: of all texts, or of those that would now pass again."""
        counts = []
        for (name, _, said), kind in self._kinds.items():
            if kind.left_out and (all_of_them or kind.free_at(now_s) >= 1):
                counts.append((name, said, kind.left_out))
                kind.left_out = 0
        return counts


class OneLineHandler(logging.StreamHandler[TextIO]):
    """Writes ``LEVEL name: message`` to stderr, after the time if `stamped`; `of` is a word before the message."""

    def __init__(self, *, stamped: bool = False, of: str = "") -> None:
        super().__init__()
        head = ("%(asctime)s " if stamped else "") + "%(levelname)s %(name)s: "
        self.setFormatter(_Escaping(f"{head}{of}: %(message)s" if of else f"{head}%(message)s"))
        self._limit = Limit()

    def emit(self, record: logging.LogRecord) -> None:
        now_s = time.monotonic()
        self._report(now_s)
        said = _NUMBER.sub(
            "#", record.getMessage()[:_TEXT_CHARS_MAX]
        )  # without counts and measurements
        if self._limit.passes((record.name, str(record.msg), said), now_s):
            super().emit(record)

    def close(self) -> None:
        self._report(time.monotonic(), all_of_them=True)
        super().close()

    def _report(self, now_s: float, *, all_of_them: bool = False) -> None:
        for name, message, count in self._limit.take_left_out(now_s, all_of_them=all_of_them):
            text = "left out %d more lines like this: %s"
            super().emit(
                logging.LogRecord(name, logging.WARNING, __file__, 0, text, (count, message), None)
            )


class _Escaping(logging.Formatter):
    def formatTime(self, record: logging.LogRecord, datefmt: str | None = None) -> str:
        return (
            datetime.fromtimestamp(record.created).astimezone().isoformat(timespec="milliseconds")
        )

    def formatMessage(self, record: logging.LogRecord) -> str:
        return escaped(super().formatMessage(record))

    def formatException(self, ei: object) -> str:
        lines = super().formatException(ei).split("\n")  # type: ignore[arg-type]
        return "\n".join(f"    {escaped(line)}" for line in lines)
