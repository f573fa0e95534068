"""The largest message that a broker accepts: what it announced, or what it rejected.

Some brokers announce a limit when a client connects. Others reject a larger message of QoS 1, silently drop one of
QoS 0, or end the connection.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

SMALL_BYTES: Final = 1024
"""No larger message is needed for a broker to end a connection for another reason."""
_AT_ONCE_NS: Final = 3_000_000_000
_FIRST_RETRY_NS, _LAST_RETRY_NS = 60_000_000_000, 3_600_000_000_000


@dataclass(slots=True)
class SizeLimit:
    """What is known of a broker's limit. Sizes are in bytes on the wire. It has no lock: its owner guards it.
    `announced`: the largest packet according to the broker; None if it set no limit. `why`: how the limit showed, once
    a message was too large; empty before.
    """

    announced: int | None = None
    why: str = ""
    _learned: int | None = None
    _proven: int = 0
    _suspected: int = 0
    _retry_ns: int = 0
    _pause_ns: int = _FIRST_RETRY_NS
    _connected_ns: int = 0

    def connected(self, announced: int | None, now_ns: int) -> None:
        """Begin a connection: sizes are tried again, but a limit that was learned stays."""
        if announced != self.announced:
            self.why = ""
        self.announced, self._proven, self._connected_ns = announced, 0, now_ns

    def refuses(self, size: int, now_ns: int) -> bool:
        """Whether the broker would reject a message of `size`. After some minutes a learned limit is tried again."""
        if self._learned is not None and now_ns >= self._retry_ns:
            self._learned, self.why = None, ""
        if self._learned is not None and size > self._learned:
            return True
        if self.announced is None or size <= self.announced:
            return False
        self.why = self.why or f"accepts packets of at most {self.announced} bytes"
        return True

    def untried(self, size: int) -> bool:
        """Whether the broker has not yet acknowledged a message of this size, so it must be sent with QoS 1."""
        return size > self._proven

    def took(self, size: int) -> None:
        """Record an acknowledged message."""
        self._proven = max(self._proven, size)
        if size >= self._suspected:
            self._suspected = 0

    def rejected(self, size: int, now_ns: int) -> None:
        """Record a message that the broker called too large."""
        self._learn(size - 1, f"rejects a message of {size} bytes as too large", now_ns)

    def lost(self, sizes: Collection[int], said_so: bool, now_ns: int) -> None:
        """Record a lost connection, and the sizes of the messages that the broker had not acknowledged.

        The broker is at fault if it said so, or if a connection that followed ended like this at once.
        """
        size = max(sizes, default=0)
        if size <= max(self._proven, SMALL_BYTES):
            return
        if said_so or (self._suspected and now_ns - self._connected_ns < _AT_ONCE_NS):
            # Below this size, so that sizes that vary need few connections.
            self._learn(
                max(size * 3 // 4, self._proven), f"ends the connection after a message of {size} bytes", now_ns
            )
        self._suspected = size

    def _learn(self, largest: int, why: str, now_ns: int) -> None:
        if self._learned is None:
            self._retry_ns = now_ns + self._pause_ns
            self._pause_ns = min(2 * self._pause_ns, _LAST_RETRY_NS)
            self.why = why
        self._learned = largest if self._learned is None else min(self._learned, largest)
