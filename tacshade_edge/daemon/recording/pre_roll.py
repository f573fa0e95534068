"""The pre-roll of a recording: the latest frames, encoded, bounded in time and in bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from tacshade_edge.types import Frame

PRE_ROLL_BYTES: Final = 64 * 2**20
"""As PNG, 12 s of grey 640x480 at 30 frames/s, 4 s in colour. Within the service's 150 MB, with 16 MiB that wait."""
EVENT_BYTES: Final = 1024


@dataclass(frozen=True, slots=True)
class Shot:
    """A captured frame with its pose, and its image as PNG.

    Attributes
    ----------
    frame : Frame
        Without pixels.
    png : bytes
    """

    frame: Frame
    png: bytes

    @property
    def t_ns(self) -> int:
        """Capture time, CLOCK_MONOTONIC, ns."""
        return self.frame.t_ns


@dataclass(frozen=True, slots=True)
class Event:
    """Something that a person who looks at the recording must know."""

    t_ns: int
    kind: str
    data: Mapping[str, object]


class Kept:
    """A first-in, first-out queue for one thread; any thread may read the counts.

    Attributes
    ----------
    frames : int
        Number of frames in it.
    given_up : int
        Frames that `bound` removed for lack of room.
    """

    def __init__(self) -> None:
        self._items: deque[Shot | Event] = deque()
        self._bytes = 0
        self.frames = self.given_up = 0

    def add(self, item: Shot | Event) -> None:
        """Add the newest item."""
        self._items.append(item)
        self._bytes += _size(item)
        self.frames += isinstance(item, Shot)

    def take(self) -> Shot | Event:
        """Remove and return the oldest item. Raises IndexError if there is none."""
        item = self._items.popleft()
        self._bytes -= _size(item)
        self.frames -= isinstance(item, Shot)
        return item

    def forget(self, oldest_ns: int) -> None:
        """Remove items older than this time."""
        while self._items and self._items[0].t_ns < oldest_ns:
            self.take()

    def bound(self, limit_bytes: int) -> None:
        """Remove the oldest items until the rest has at most this many bytes."""
        while self._bytes > limit_bytes:
            self.given_up += isinstance(self.take(), Shot)

    def __len__(self) -> int:
        return len(self._items)


def _size(item: Shot | Event) -> int:
    return len(item.png) if isinstance(item, Shot) else EVENT_BYTES
