"""Frames lost between time stamps, where a device gives no sequence number."""

from __future__ import annotations

from collections import deque
from statistics import fmean

_WINDOW = 64  # intervals that the period is measured over: about two seconds at 30 fps
_FIRST = 8  # intervals before the period is trusted; these are judged together when it is


class FrameGaps:
    """Counts the frames missing between consecutive time stamps, against the period that was measured.

    The rate that a driver states or was asked for is not used: cameras run at another one. The period is the mean
    of the intervals near the lower quartile of the last 64, so it holds while less than about half of the frames
    are lost. A camera that halves its rate looks like one that loses every second frame until the window has
    turned over.
    """

    def __init__(self) -> None:
        self._intervals_ns: deque[int] = deque(maxlen=_WINDOW)
        self._last_ns: int | None = None
        self._judged = False

    @property
    def period_ns(self) -> float:
        """The measured frame period; 0 until there is an interval."""
        if not self._intervals_ns:
            return 0.0
        ordered = sorted(self._intervals_ns)
        quartile = ordered[len(ordered) // 4]
        return fmean(i for i in ordered if 0.5 * quartile <= i <= 1.5 * quartile)

    def add(self, t_ns: int) -> int:
        """Take the next frame's time stamp (ns, any origin); return how many lost frames it revealed.

        A time stamp that does not advance is passed over: it tells nothing.
        """
        last_ns, self._last_ns = self._last_ns, t_ns
        if last_ns is None or t_ns <= last_ns:
            return 0
        self._intervals_ns.append(t_ns - last_ns)
        if len(self._intervals_ns) < _FIRST:
            return 0
        period_ns = self.period_ns
        fresh = [t_ns - last_ns] if self._judged else list(self._intervals_ns)
        self._judged = True
        return sum(max(round(interval_ns / period_ns) - 1, 0) for interval_ns in fresh)
