"""A queue of frames and events that is bounded in bytes: what does not fit is refused and counted, never waited for."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class ByteQueue(Generic[T]):
    """First in, first out, between two threads.

    Parameters
    ----------
    limit_bytes : int
        More than this is never held, except that an empty queue takes one item of any size.

    Attributes
    ----------
    refused : int
        Items that found it full.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._ready = threading.Condition()
        self._items: deque[tuple[T, int]] = deque()
        self._bytes = 0
        self._closed = False
        self.refused = 0

    def put(self, item: T, size_bytes: int, *, reserve_bytes: int = 0) -> None:
        """Leave an item for the taker; refused and counted when full, ignored when closed.

        Parameters
        ----------
        item
        size_bytes : int
        reserve_bytes : int
            So much above the limit is for this kind of item alone.
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
        """The oldest item; None when none came in time, or when the queue is drained."""
        with self._ready:
            self._ready.wait_for(lambda: self._items or self._closed, timeout_s)
            if not self._items:
                return None
            item, size_bytes = self._items.popleft()
            self._bytes -= size_bytes
            return item

    def close(self) -> None:
        """Take nothing more; what is there can still be taken."""
        with self._ready:
            self._closed = True
            self._ready.notify_all()

    @property
    def drained(self) -> bool:
        """Closed, and empty."""
        with self._ready:
            return self._closed and not self._items

    def __len__(self) -> int:
        return len(self._items)
