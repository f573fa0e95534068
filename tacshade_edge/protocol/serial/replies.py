"""Handle repeated commands: each number is executed once, and its reply is kept for repeats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from tacshade_edge.protocol.serial.line import SEQ_MODULO
from tacshade_edge.protocol.serial.verbs import Command
from tacshade_edge.reasons import Reason, ReasonCode

REPLIES_KEPT: Final = 64


@dataclass(frozen=True, slots=True)
class Repeat:
    """A repeated line; `reply` is None while its command is still in progress."""

    reply: str | None


@dataclass(slots=True)
class _Entry:
    text: str
    command: Command | None
    reply: str | None = None


class ReplyCache:
    """The newest numbers of one session, from one ``HELLO`` to the next.

    Parameters
    ----------
    newest : int or None
        The number of the ``HELLO``.
    """

    def __init__(self, newest: int | None = None) -> None:
        self._newest = newest
        self._entries: dict[int, _Entry] = {}

    def admit(self, seq: int, text: str, command: Command | None) -> Repeat | Reason | None:
        """Register a numbered line: None if it is new and must be executed, a `Repeat`, or why it is rejected."""
        known = self._entries.get(seq)
        if known is not None:
            if known.text != text:
                return Reason(ReasonCode.NUMBER_REUSED, "found the number of another line, expected a new number")
            return Repeat(known.reply)
        behind = 0 if self._newest is None else (self._newest - seq) % SEQ_MODULO
        if REPLIES_KEPT <= behind < SEQ_MODULO // 2:  # its reply may be gone: it may have been executed
            text = f"found an old line number, expected HELLO or a number above #{self._newest}"
            return Reason(ReasonCode.NUMBER_STALE, text)
        if self._newest is None or behind >= SEQ_MODULO // 2:
            self._newest = seq
            for old in [s for s in self._entries if (seq - s) % SEQ_MODULO >= REPLIES_KEPT]:
                del self._entries[old]
        self._entries[seq] = _Entry(text, command)
        return None

    def keep(self, seq: int, command: Command | None, reply: str) -> bool:
        """Keep the reply to a line that was admitted with `command`; False if the number no longer belongs to it."""
        entry = self._entries.get(seq)
        if entry is None or entry.command is not command:
            return False
        entry.reply = reply
        return True
