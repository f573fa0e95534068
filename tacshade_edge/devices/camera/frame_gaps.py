"""Detection of lost frames by their time stamps, for devices without sequence numbers."""

from __future__ import annotations

from collections import deque

_WINDOW = 64  # number of intervals that give the period: about two seconds at 30 fps
_ROUNDS = 2
_FIRST = 24  # intervals before the period is trusted: about a second; then all of them are judged together
_REGULAR = 0.2  # relative: an interval this near the period is one period, however the estimate changes


class FrameGaps:
    """A counter of the frames missing between consecutive time stamps, given the measured period.

    The stated or requested rate is not used: cameras run at another one. The period is the sum of the last 64 intervals
    divided by the number of periods in them, starting from their lower quartile. The estimate is valid while less than
    a third of the frames are lost and the stamps are off by less than 15 % of the period. A camera that halves its rate
    looks like one that loses every second frame until the window has been replaced.

    `period_ns`: the measured frame period in ns; 0 before the first interval.
    """

    def __init__(self) -> None:
        self._intervals_ns: deque[int] = deque(maxlen=_WINDOW)
        self._last_ns: int | None = None
        self._judged = False
        self._until_measured = 0  # regular intervals
        self.period_ns = 0.0

    def add(self, t_ns: int) -> int:
        """Add the next frame's time stamp (ns, any origin); return how many lost frames it revealed.

        A time stamp that does not advance is ignored.
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
        # In a sum of intervals the jitter cancels, except that of the first and the last stamp.
        period_ns = sum(ordered_ns) / sum(max(round(interval_ns / period_ns), 1) for interval_ns in ordered_ns)
    return period_ns
