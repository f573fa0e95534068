"""The rate of a sender's clock against arrivals: whether its times are in the unit that they should
be in, and pass at all.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from tacshade_edge.plausibility.suspicions import Suspicion, SuspicionCode, suspicion
from tacshade_edge.plausibility.units import TIMES, nearest

WINDOW_NS: Final = 500_000_000
WINDOWS: Final = 4
"""So many windows in a row must agree: a backlog that arrives at once spoils one or two."""
RATE_MAX: Final = 50.0
"""No line delays so much that right times seem to pass this much faster or slower."""
_AGREE: Final = 3.0
STANDS_NS: Final = 3_000_000_000
_UNIT_WITHIN: Final = 3.0


class StreamClock:
    """The rate of one sender's clock, from its stamps in order of arrival."""

    def __init__(self) -> None:
        self._anchor: tuple[int, int] | None = None
        self._rates: deque[float] = deque(maxlen=WINDOWS)
        self._found: Suspicion | None = None
        self._changed_ns = 0
        self._newest_ns: int | None = None
        self._stands = False

    def take(self, stamp_ns: int, arrived_ns: int) -> None:
        """Take a stamp, and when it arrived."""
        if stamp_ns != self._newest_ns:
            self._newest_ns, self._changed_ns = stamp_ns, arrived_ns
        self._stands = arrived_ns - self._changed_ns >= STANDS_NS
        if self._anchor is None:
            self._anchor = stamp_ns, arrived_ns
            return
        stamp0_ns, arrived0_ns = self._anchor
        # A clock of whole seconds stands for most windows, and one at rest for all.
        if stamp_ns == stamp0_ns or arrived_ns - arrived0_ns < WINDOW_NS:
            return
        self._anchor = stamp_ns, arrived_ns
        self._rates.append((stamp_ns - stamp0_ns) / (arrived_ns - arrived0_ns))
        judged = _judge(self._rates)
        if judged is None and 1 / RATE_MAX < self._rates[-1] < RATE_MAX:
            self._found = None
        elif judged is not None and not _same(judged, self._found):
            self._found = judged

    @property
    def found(self) -> Suspicion | None:
        """That the times pass at a rate that no clock in ns has; None if they do not."""
        return self._found

    @property
    def stands(self) -> Suspicion | None:
        """That one time is sent again and again; None if it is not.

        It says nothing of the times before and after.
        """
        return suspicion(SuspicionCode.CLOCK_STANDS) if self._stands else None


def _same(one: Suspicion, other: Suspicion | None) -> bool:
    """Whether both say the same, but for a rate that differs a little with every window."""
    return other is not None and (one.code, one.values.get("unit")) == (
        other.code,
        other.values.get("unit"),
    )


def _judge(rates: deque[float]) -> Suspicion | None:
    if len(rates) < WINDOWS:
        return None
    if max(rates) < 0:
        return suspicion(SuspicionCode.CLOCK_COUNTS_DOWN, impossible=True, rate=sorted(rates)[1])
    low, high = min(rates), max(rates)
    if low <= 0 or high > _AGREE * low or (high > 1 / RATE_MAX and low < RATE_MAX):
        return None
    rate = sorted(rates)[len(rates) // 2]
    unit = nearest(1 / rate, TIMES, _UNIT_WITHIN)
    return suspicion(SuspicionCode.CLOCK_RATE, impossible=True, rate=rate, unit=unit)
