"""One slot between two threads: the newest item wins, nothing queues up."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """A slot for one item, from which one thread takes.

    Two locks replace a condition: `put` wakes the taker in its last step, so that the taker never wakes only to wait
    for `put`.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ready = threading.Lock()  # held while there is nothing to take
        self._ready.acquire()
        self._item: T | None = None
        self._closed = False

    def put(self, item: T) -> T | None:
        """Leave `item` for the taker; never waits.

        Returns
        -------
        The item that it replaced, or `item` itself if the mailbox is closed: the caller accounts for it.
        """
        with self._lock:
            if self._closed:
                return item
            replaced, self._item = self._item, item
        if replaced is None:
            self._ready.release()
        return replaced

    def take(self) -> T | None:
        """Wait for the item; None once the mailbox is closed and empty."""
        self._ready.acquire()
        with self._lock:
            item, self._item = self._item, None
            if self._closed:
                self._ready.release()
        return item

    def close(self) -> None:
        """Let the taker have the item in the slot, then None."""
        with self._lock:
            wakes = self._item is None and not self._closed
            self._closed = True
        if wakes:
            self._ready.release()
