"""A queue of frames and events, bounded in bytes: what does not fit is refused and counted, and nobody waits for it."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class ByteQueue(Generic[T]):
    """A first-in, first-out queue between two threads.

    Parameters
    ----------
    limit_bytes : int
        Most bytes to hold, except that an empty queue takes one item of any size.

    Attributes
    ----------
    refused : int
        Number of items that found the queue full.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._ready = threading.Condition()
        self._items: deque[tuple[T, int]] = deque()
        self._bytes = 0
        self._closed = False
        self.refused = 0

    def put(self, item: T, size_bytes: int, *, reserve_bytes: int = 0) -> None:
        """Add an item for the taker; refuse and count it if full, ignore it if closed.

        Parameters
        ----------
        item
        size_bytes : int
        reserve_bytes : int
            Room above the limit that is reserved for this kind of item.
        """
        with self._ready:
            if self._closed:
                return
            if self._items and self._bytes + size_bytes > self._limit + reserve_bytes:
                self.refused += 1
                return
            self._items.append((item, size_bytes))
            self._bytes += size_bytes
            self._ready.notify()

    def take(self, timeout_s: float) -> T | None:
        """The oldest item; None if none came in time, or if the queue is drained."""
        with self._ready:
            self._ready.wait_for(lambda: self._items or self._closed, timeout_s)
            if not self._items:
                return None
            item, size_bytes = self._items.popleft()
            self._bytes -= size_bytes
            return item

    def close(self) -> None:
        """Accept nothing more; what is in the queue can still be taken."""
        with self._ready:
            self._closed = True
            self._ready.notify_all()

    @property
    def drained(self) -> bool:
        """Whether the queue is closed and empty."""
        with self._ready:
            return self._closed and not self._items

    def __len__(self) -> int:
        return len(self._items)
