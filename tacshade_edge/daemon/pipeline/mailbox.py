"""One slot between two threads: the newest item wins, nothing queues up."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """A slot for one item."""

    def __init__(self) -> None:
        self._ready = threading.Condition()
        self._item: T | None = None
        self._closed = False

    def put(self, item: T) -> T | None:
        """Leave `item` for the taker; never waits.

        Returns
        -------
        The item that it replaced, or `item` itself when the mailbox is closed: the caller accounts for it.
        """
        with self._ready:
            if self._closed:
                return item
            replaced, self._item = self._item, item
            self._ready.notify()
            return replaced

    def take(self) -> T | None:
        """Wait for the item; None once the mailbox is closed and empty."""
        with self._ready:
            self._ready.wait_for(lambda: self._item is not None or self._closed)
            item, self._item = self._item, None
            return item

    def close(self) -> None:
        """Let the taker have what is there, then None."""
        with self._ready:
            self._closed = True
            self._ready.notify_all()
