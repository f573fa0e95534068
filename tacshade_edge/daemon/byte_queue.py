"""A queue between two threads that is bounded in bytes, since images differ in size by the mode of
a camera.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class ByteQueue(Generic[T]):
    """A first-in, first-out queue between two threads, bounded in bytes."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._ready = threading.Condition()
        self._items: deque[tuple[T, int]] = deque()
        self._bytes = 0
        self._closed = False

    def put(self, item: T, size_bytes: int, *, reserve_bytes: int = 0) -> bool:
        """Add an item, or return False if full.

        `reserve_bytes` above the limit are for this kind of item.
        """
        with self._ready:
            # An item alone always fits: a frame larger than the queue must not be refused for
            # ever. So does one without a size: beside such a frame, an end must find room.
            full = self._bytes + size_bytes > self._limit + reserve_bytes
            if self._items and size_bytes and full:
                return False
            self._items.append((item, size_bytes))
            self._bytes += size_bytes
            self._ready.notify()
            return True

    def take(self, timeout_s: float) -> T | None:
        with self._ready:
            # Closed is not empty: what waits is still taken.
            self._ready.wait_for(lambda: self._items or self._closed, timeout_s)
            if not self._items:
                return None
            item, size_bytes = self._items.popleft()
            self._bytes -= size_bytes
            return item

    def close(self) -> None:
        with self._ready:
            self._closed = True
            self._ready.notify_all()

    @property
    def drained(self) -> bool:
        with self._ready:
            return self._closed and not self._items

    def __len__(self) -> int:
        return len(self._items)
