"""Frames lost between time stamps, where a device gives no sequence number."""

from __future__ import annotations

from collections import deque

_WINDOW = 64  # intervals that the period is measured over: about two seconds at 30 fps
_ROUNDS = 2
_FIRST = 24  # intervals before the period is trusted: about a second; these are judged together when it is
_REGULAR = 0.2  # an interval this near the period, as part of it, is one period however the period is measured anew


class FrameGaps:
    """Counts the frames missing between consecutive time stamps, against the period that was measured.

    The rate that a driver states or was asked for is not used: cameras run at another one. The period is the last
    64 intervals divided by the periods that each is found to hold, starting from their lower quartile. It holds
    while less than a third of the frames are lost and the stamps are off by less than 15 % of the period. A camera
    that halves its rate looks like one that loses every second frame until the window has turned over.

    Attributes
    ----------
    period_ns : float
        The measured frame period; 0 until there is an interval.
    """

    def __init__(self) -> None:
        self._intervals_ns: deque[int] = deque(maxlen=_WINDOW)
        self._last_ns: int | None = None
        self._judged = False
        self._until_measured = 0  # regular intervals
        self.period_ns = 0.0

    def add(self, t_ns: int) -> int:
        """Take the next frame's time stamp (ns, any origin); return how many lost frames it revealed.

        A time stamp that does not advance is passed over: it shows nothing.
        """
        last_ns, self._last_ns = self._last_ns, t_ns
        if last_ns is None or t_ns <= last_ns:
            return 0
        interval_ns = t_ns - last_ns
        self._intervals_ns.append(interval_ns)
        self._until_measured -= 1
        if self._until_measured > 0 and abs(interval_ns - self.period_ns) < _REGULAR * self.period_ns:
            return 0
        self.period_ns = period_ns = _period_ns(sorted(self._intervals_ns))
        if len(self._intervals_ns) < _FIRST:
            return 0
        self._until_measured = _WINDOW
        fresh = [interval_ns] if self._judged else list(self._intervals_ns)
        self._judged = True
        return sum(max(round(interval_ns / period_ns) - 1, 0) for interval_ns in fresh)


def _period_ns(ordered_ns: list[int]) -> float:
    period_ns = float(ordered_ns[len(ordered_ns) // 4])
    for _ in range(_ROUNDS):
        # In a sum of intervals the jitter of all stamps but the first and the last cancels.
        period_ns = sum(ordered_ns) / sum(max(round(interval_ns / period_ns), 1) for interval_ns in ordered_ns)
    return period_ns
