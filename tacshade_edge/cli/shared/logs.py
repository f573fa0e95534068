"""The log of long-running commands: one line per message, repeated ones limited;
text from outside is escaped.
"""

from __future__ import annotations

import argparse
import logging
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final, TextIO

from tacshade_edge import libsystemd
from tacshade_edge.cli.shared.journal import is_journal
from tacshade_edge.quoting import escaped

# Where sd_journal_sendv(3) writes.
_JOURNAL: Final = "/run/systemd/journal/socket"
_ROOM_S: Final = 0.1
"""How long a message waits for room in the journal's queue before it goes the way of stderr."""

AT_ONCE: Final = 10
PERIOD_S: Final = 10.0
"""Limit on what says the same but for its numbers: AT_ONCE in a burst, then one per PERIOD_S."""

_TEXTS_MAX: Final = 16
_KINDS_MAX: Final = 128
"""Texts that are distinguished, of one format and in all; any further text of a format counts as
one until a quiet text is forgotten.
"""
_TEXT_CHARS_MAX: Final = 200
# Numbers that stand alone, as counts and measurements do. Those within names, paths, addresses and
# times stay: they tell texts apart.
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


def start_logging(level: int, sensor_id: str = "", *, each_line: bool = True) -> None:
    """Log to stderr, with time stamps unless the journal adds them;
    with `sensor_id`, if given, in each line.

    The journal gets a message's priority, place and SENSOR_ID as fields if python3-systemd is
    installed, else its priority alone.
    """
    handler: logging.Handler
    # A process of one sensor need not repeat its name; the journal still gets it as a field.
    of = sensor_id if each_line else ""
    if not is_journal():
        handler = OneLineHandler(stamped=True, of=of)
    elif library := libsystemd.module("journal"):
        handler = FieldsHandler(library.send, of=of, sensor_id=sensor_id)
    else:
        handler = OneLineHandler(prioritised=True, of=of)
    # `force`: a daemon starts the log again as soon as its settings name the sensor.
    logging.basicConfig(level=level, handlers=[handler], force=True)
    # At level DEBUG, these libraries would log every packet and its content.
    for name in ("asyncio", "websockets", "paho"):
        logging.getLogger(name).setLevel(max(level, logging.INFO))


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
            # Those that are quiet again would pass like new ones, so nothing is lost with them;
            # counts that nobody has reported yet stay.
            kept = {
                key: kind
                for key, kind in self._kinds.items()
                if kind.left_out or kind.free_at(now_s) < AT_ONCE
            }
            self._kinds = kept
        if self._is_too_many(text):
            text = (name, form, form)
        # A format may itself be made from data and so vary without end; then all further ones count
        # as one.
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
        """Return and reset the counts of left-out messages:
        of all texts, or of those that would now pass again.
        """
        counts = []
        for (name, _, said), kind in self._kinds.items():
            if kind.left_out and (all_of_them or kind.free_at(now_s) >= 1):
                counts.append((name, said, kind.left_out))
                kind.left_out = 0
        return counts


class OneLineHandler(logging.StreamHandler[TextIO]):
    """Writes ``LEVEL name: message`` to stderr; `of` is a word before the message.

    Before it comes the time if `stamped`, or if `prioritised` a priority as the journal reads it
    (sd-daemon(3)).
    """

    def __init__(self, *, stamped: bool = False, prioritised: bool = False, of: str = "") -> None:
        super().__init__()
        head = ("%(asctime)s " if stamped else "") + "%(levelname)s %(name)s: "
        form = f"{head}{of}: %(message)s" if of else f"{head}%(message)s"
        self.setFormatter(_Prioritising(form) if prioritised else _Escaping(form))
        self._limit = Limit()

    def emit(self, record: logging.LogRecord) -> None:
        now_s = time.monotonic()
        self._report(now_s)
        # Messages that differ in counts and measurements alone say the same.
        said = _NUMBER.sub("#", record.getMessage()[:_TEXT_CHARS_MAX])
        if self._limit.passes((record.name, str(record.msg), said), now_s):
            self.write(record)

    def write(self, record: logging.LogRecord) -> None:
        """Write a message that is not one too many."""
        logging.StreamHandler.emit(self, record)

    def close(self) -> None:
        self._report(time.monotonic(), all_of_them=True)
        super().close()

    def _report(self, now_s: float, *, all_of_them: bool = False) -> None:
        for name, message, count in self._limit.take_left_out(now_s, all_of_them=all_of_them):
            # Written past the limit, which would leave out this line too.
            text = "left out %d more lines like this: %s"
            self.write(
                logging.LogRecord(name, logging.WARNING, __file__, 0, text, (count, message), None)
            )


class FieldsHandler(OneLineHandler):
    """Sends the same messages to the journal, each as one entry with fields
    (systemd.journal-fields(7)).

    A journal that does not read gets them as lines, by stderr.
    """

    def __init__(self, send: Callable[..., None], *, of: str, sensor_id: str) -> None:
        super().__init__(prioritised=True, of=of)
        self._send = send
        # Only formats: an entry has the priority as a field, not in front of its text.
        self._entry = OneLineHandler(of=of)
        self._fields = {"SYSLOG_IDENTIFIER": "tacshade-edge"}
        self._fields |= {"SENSOR_ID": sensor_id} if sensor_id else {}

    def write(self, record: logging.LogRecord) -> None:
        place = {
            "PRIORITY": str(priority_of(record.levelno)),
            "CODE_FILE": record.pathname,
            "CODE_LINE": record.lineno,
            "CODE_FUNC": record.funcName or "",
            "LOGGER": record.name,
            "THREAD_NAME": record.threadName or "",
        }
        try:
            if libsystemd.has_room(_JOURNAL, _ROOM_S):
                self._send(self._entry.format(record), **place, **self._fields)
                return
        except OSError:
            # No journal is there, or it does not take this entry: a line on stderr still arrives.
            pass
        super().write(record)


def priority_of(level: int) -> int:
    """The priority of a level (syslog(3)): 2 critical, 3 error, 4 warning, 6 info, 7 debug."""
    limits = (logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6)
    return next((priority for least, priority in limits if level >= least), 7)


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


class _Prioritising(_Escaping):
    def format(self, record: logging.LogRecord) -> str:
        lines = super().format(record).split("\n")
        # journald reads a priority at the start of each line, so every line of a traceback needs
        # one.
        return "\n".join(f"<{priority_of(record.levelno)}>{line}" for line in lines)
