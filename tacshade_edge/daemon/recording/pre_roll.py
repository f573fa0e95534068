"""The pre-roll of a recording: the latest frames, encoded, bounded in time and in bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from tacshade_edge.types import Frame

PRE_ROLL_BYTES: Final = 64 * 2**20
"""Of PNG: 12 s of grey 640x480 at 30 frames/s, 4 s in colour. Beside 16 MiB that wait, of the 150 MB of the service."""
EVENT_BYTES: Final = 1024


@dataclass(frozen=True, slots=True)
class Shot:
    """A captured frame with its pose, its image as PNG.

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
        """When it was captured."""
        return self.frame.t_ns


@dataclass(frozen=True, slots=True)
class Event:
    """Something that a person who looks at the recording must know."""

    t_ns: int
    kind: str
    data: Mapping[str, object]


class Kept:
    """First in, first out; used by one thread, counted by any.

    Attributes
    ----------
    frames : int
        That are in it.
    given_up : int
        Frames that `bound_bytes` had no room for.
    """

    def __init__(self) -> None:
        self._items: deque[Shot | Event] = deque()
        self._bytes = 0
        self.frames = self.given_up = 0

    def add(self, item: Shot | Event) -> None:
        """The newest."""
        self._items.append(item)
        self._bytes += _size(item)
        self.frames += isinstance(item, Shot)

    def take(self) -> Shot | Event:
        """The oldest. Raises IndexError when there is none."""
        item = self._items.popleft()
        self._bytes -= _size(item)
        self.frames -= isinstance(item, Shot)
        return item

    def forget(self, oldest_ns: int) -> None:
        """Take out what is older than that."""
        while self._items and self._items[0].t_ns < oldest_ns:
            self.take()

    def bound(self, limit_bytes: int) -> None:
        """Take out the oldest until the rest has no more bytes than that."""
        while self._bytes > limit_bytes:
            self.given_up += isinstance(self.take(), Shot)

    def __len__(self) -> int:
        return len(self._items)


def _size(item: Shot | Event) -> int:
    return len(item.png) if isinstance(item, Shot) else EVENT_BYTES
