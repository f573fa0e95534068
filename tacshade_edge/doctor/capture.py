"""Takes frames from the daemon's source as the daemon does, before the checks judge them."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field

from tacshade_edge.devices.base import FrameSource
from tacshade_edge.errors import TacshadeError
from tacshade_edge.reasons import Reason
from tacshade_edge.types import U8

FRAMES = 30
LIMIT_S = 3.0
_IMAGES_KEPT = 10  # the last ones, because a camera may still be settling during the first
_SETTLING = 5


@dataclass(frozen=True, slots=True, eq=False)
class Captured:
    """Frames and facts from a source.

    Attributes
    ----------
    images : tuple of uint8 (H, W) or (H, W, 3)
        At most the last ten.
    t_ns, arrived_ns : tuple of int
        CLOCK_MONOTONIC when each frame was taken, as the source reports, and when it was read.
    dropped : int
        Dropped frames as the source counts them.
    described : dict
        The negotiated mode, as in ``status/camera``.
    error : Reason or None
        Why the source did not open or failed; None if neither happened.
    """

    images: tuple[U8, ...] = ()
    t_ns: tuple[int, ...] = ()
    arrived_ns: tuple[int, ...] = ()
    dropped: int = 0
    described: dict[str, str | int | float] = field(default_factory=dict)
    error: Reason | None = None

    @property
    def fps(self) -> float:
        """Frames per second, measured without the first frames, which often come late; 0 if there are too few."""
        t_ns = self.t_ns[_SETTLING:]
        return 1e9 * (len(t_ns) - 1) / (t_ns[-1] - t_ns[0]) if len(t_ns) > 1 and t_ns[-1] > t_ns[0] else 0.0


def capture(source: FrameSource) -> Captured:
    """Open a source, read 30 frames or as many as come within 3 s, and close it."""
    images: deque[U8] = deque(maxlen=_IMAGES_KEPT)
    t_ns: list[int] = []
    arrived_ns: list[int] = []
    described: dict[str, str | int | float] = {}
    error: Reason | None = None
    try:
        source.open()
        deadline_s = time.monotonic() + LIMIT_S
        while len(t_ns) < FRAMES and time.monotonic() < deadline_s and (frame := source.read()) is not None:
            images.append(frame.image)
            t_ns.append(frame.t_ns)
            arrived_ns.append(time.monotonic_ns())
        described = source.describe()
    except TacshadeError as failure:
        error = failure.reason
    finally:
        source.close()
    return Captured(tuple(images), tuple(t_ns), tuple(arrived_ns), source.dropped, described, error)
