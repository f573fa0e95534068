"""The frames and events that the thread `record` keeps: those that a recording has still to write,
and without a recording the latest ones, with which the next begins.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal

from tacshade_edge.recording.recording_content import Event
from tacshade_edge.types import Frame

PRE_ROLL_BYTES: Final = 64 * 2**20
"""As PNG, 12 s of grey 640x480 at 30 frames/s, 4 s in colour.

Within the service's 150 MB, with 16 MiB that wait.
"""
EVENT_BYTES: Final = 1024


@dataclass(frozen=True, slots=True)
class Shot:
    """A captured frame with its pose but without pixels, and its image as PNG."""

    frame: Frame
    png: bytes

    @property
    def t_ns(self) -> int:
        return self.frame.t_ns


Kept = Shot | Event | Literal["end"]


class PreRoll:
    """What is kept; the thread `record` changes it, any thread may read its numbers.

    `length_ns` may be set while the thread runs; 0 keeps nothing. `oldest_ns`: older frames are of
    another calibration.
    """

    def __init__(self, length_ns: int) -> None:
        self.kept: deque[Kept] = deque()
        self.length_ns = length_ns
        self.oldest_ns = 0
        self.frames = 0
        self.given_up = 0  # frames without room

    def bound(self, now_ns: int) -> None:
        """Keep only the pre-roll; without one, nothing."""
        kept, length_ns = self.kept, self.length_ns
        oldest_ns = max(now_ns - length_ns, self.oldest_ns) if length_ns else 2**63
        while kept and (isinstance(kept[0], str) or kept[0].t_ns < oldest_ns):
            kept.popleft()
        # Summed anew rather than kept: a recording, too, takes from the left, in another function.
        too_many_bytes = sum(map(_size, kept)) - PRE_ROLL_BYTES
        while too_many_bytes > 0:
            item = kept.popleft()
            too_many_bytes -= _size(item)
            self.given_up += isinstance(item, Shot)
        self.frames = frames_among(kept)


def frames_among(items: Iterable[object]) -> int:
    """How many of the items are frames, whether encoded or not."""
    return sum(isinstance(item, Shot | Frame) for item in items)


def _size(item: Kept) -> int:
    return len(item.png) if isinstance(item, Shot) else EVENT_BYTES
