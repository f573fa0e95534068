"""Synchronise the robot's clock with the daemon's:
daemon = robot + offset, where the offset is a line over time.

With ``SYNC`` (two-way), every exchange has four times, t1 and t4 of the robot and t2 and t3 of the
daemon. Its offset ((t2 - t1) + (t3 - t4)) / 2 is wrong by at most half its round trip, whatever the
cable does (NTP's on-wire protocol, RFC 5905 section 8). As NTP's clock filter prefers the samples
of least delay (RFC 5905 section 10), the line is fitted to the quarter of the latest exchanges with
the shortest round trips; an exchange beyond that bound shows a clock jump.

Without ``SYNC`` (one-way), only times of arrival are known: the offset is a line under all delays,
from their lower convex hull (Moon, Skelly and Towsley, "Estimation and removal of clock skew from
network delay measurements", INFOCOM 1999; Zhang, Liu and Xia, "Clock synchronization algorithms for
network measurements", INFOCOM 2002). One side alone cannot measure the least delay itself; it is
assumed to be at most `ONE_WAY_LATENCY_NS`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from tacshade_edge.plausibility.stream_clock import StreamClock
from tacshade_edge.plausibility.suspicions import Suspicion
from tacshade_edge.reasons import Reason, ReasonCode

SyncMode = Literal["none", "oneway", "two-way"]

# Measured: a line through the best quarter of 60 exchanges is within 0.07 ms RMS over USB CDC, and
# 0.16 ms on a loaded board.
EXCHANGES_KEPT: Final = 60
EXCHANGE_AGE_MAX_NS: Final = 300_000_000_000
BEST_FRACTION, BEST_MIN = 1 / 4, 4  # of the exchanges
# Of a line without new exchanges; beyond it, arrivals are more accurate.
TWO_WAY_ERROR_MAX_NS: Final = 20_000_000
DRIFT_EXPECTED: Final = 1e-3  # of a ceramic resonator; a crystal has a tenth of it
TOLERANCE_NS: Final = 20_000  # reading a clock
DRIFT_REPORTED_PPM: Final = 500.0
ONE_WAY_LATENCY_NS: Final = 2_000_000
BUCKET_NS: Final = 1_000_000_000
BUCKETS_KEPT: Final = 60
# This much later than the envelope for `LATE_BUCKETS`: the clock was set back.
LATE_NS: Final = 50_000_000
LATE_BUCKETS: Final = 3
BACKWARDS_NS: Final = 1_000_000_000  # a robot's time that goes back by more has restarted


@dataclass(frozen=True, slots=True)
class ConvertedTime:
    """A time converted from one clock to the other, with its error bound."""

    t_ns: int
    error_ns: int


@dataclass(frozen=True, slots=True)
class SyncState:
    """How well the robot's clock is known."""

    mode: SyncMode
    reason: Reason | None  # why it is unknown, or what is wrong with it
    offset_ns: int  # daemon minus robot now; 0 with ``none``
    drift_ppm: float  # how slow the robot's clock is
    error_us: int  # bound
    suspected: Suspicion | None = None  # of the robot's times, which are then of no use


@dataclass(slots=True)
class SyncCounts:
    """Counts since the start."""

    exchanges: int = 0
    exchanges_refused: int = 0  # their times are contradictory
    outliers: int = 0  # single exchanges that contradict those before and after
    restarts: int = 0  # the clock jumped, went back, or the robot restarted


@dataclass(frozen=True, slots=True)
class _Exchange:
    robot_ns: int  # its middle
    offset_ns: int
    round_trip_ns: int


@dataclass(frozen=True, slots=True)
class _Line:
    """Offset of the daemon's clock at a robot's time;
    base and rest are separate because a float has 53 bits.
    """

    at_ns: int
    base_ns: int
    rest_ns: float
    slope: float
    slope_sigma: float
    sigma_ns: float
    bound_ns: float

    def local(self, robot_ns: int) -> ConvertedTime:
        after_ns = robot_ns - self.at_ns
        return ConvertedTime(
            robot_ns + self.base_ns + round(self.rest_ns + self.slope * after_ns),
            self.error_ns(after_ns),
        )

    def robot(self, local_ns: int) -> ConvertedTime:
        after_ns = round(((local_ns - self.at_ns - self.base_ns) - self.rest_ns) / (1 + self.slope))
        return ConvertedTime(self.at_ns + after_ns, self.error_ns(after_ns))

    def error_ns(self, after_ns: int) -> int:
        return round(self.bound_ns + 2 * math.hypot(self.sigma_ns, self.slope_sigma * after_ns))


class ClockSync:
    """The synchronisation with one robot's clock."""

    def __init__(self) -> None:
        self.counts = SyncCounts()
        self._stamps = StreamClock()
        # Why the clock is unknown, or was the last time that it was.
        self.reason_unknown = Reason(ReasonCode.NOTHING_RECEIVED, "the robot has sent nothing yet")
        # The times t1, t2, t3 of the latest SYNC; t4 comes with the next.
        self._open: tuple[int, int, int] | None = None
        self._exchanges: deque[_Exchange] = deque(maxlen=EXCHANGES_KEPT)
        self._suspect: _Exchange | None = None
        self._two_way: _Line | None = None
        # Of arrivals: time, least delay.
        self._buckets: deque[tuple[int, int]] = deque(maxlen=BUCKETS_KEPT)
        self._bucket: tuple[int, int] | None = None
        self._one_way: _Line | None = None
        self._newest_ns: int | None = None

    def robot_restarted(self) -> None:
        """Forget the clock, because the robot has another one."""
        self._stamps = StreamClock()
        self._restart(Reason(ReasonCode.ROBOT_RESTARTED, "the robot restarted"))

    def _restart(self, reason: Reason) -> None:
        self._forget()
        self.reason_unknown = reason
        self.counts.restarts += 1

    def sync_received(self, t1_ns: int, t2_ns: int, t4_ns: int | None) -> None:
        """Take a ``SYNC t1 [t4]`` that arrived at `t2_ns`; t4 completes the previous exchange.

        Then `sync_answered`.
        """
        if self._is_off(t1_ns, t2_ns):
            return
        # Until `sync_answered`, the reply counts as sent when the request arrived, which can only
        # make the round trip look longer.
        before, self._open = self._open, (t1_ns, t2_ns, t2_ns)
        if t4_ns is not None and before is not None:
            first_ns, received_ns, sent_ns = before
            round_trip_ns = (t4_ns - first_ns) - (sent_ns - received_ns)
            if first_ns <= t4_ns <= t1_ns and round_trip_ns >= 0:
                offset_ns = ((received_ns - first_ns) + (sent_ns - t4_ns)) // 2
                self._add(_Exchange((first_ns + t4_ns) // 2, offset_ns, round_trip_ns))
            else:
                self.counts.exchanges_refused += 1
        self._advance(t1_ns)

    def sync_answered(self, t3_ns: int) -> None:
        """Take the time `t3_ns` at which the port got the reply to the latest ``SYNC``."""
        if self._open is not None:
            self._open = (*self._open[:2], t3_ns)

    def stamp_received(self, robot_ns: int, arrived_ns: int) -> None:
        """Take the arrival of a message stamped `robot_ns`:
        one more delay, which may show that the clock jumped.
        """
        if self._is_off(robot_ns, arrived_ns):
            return
        if (line := self._two_way) is not None:
            local = line.local(robot_ns)
            if local.t_ns - local.error_ns - TOLERANCE_NS > arrived_ns:
                self._restart(Reason(ReasonCode.CLOCK_JUMPED, "the robot's clock jumped forward"))
        self._advance(robot_ns)
        delay_ns = arrived_ns - robot_ns
        bucket = self._bucket
        if bucket is None or robot_ns - bucket[0] >= BUCKET_NS:
            if bucket is not None:
                self._close_bucket(bucket)
            self._bucket = robot_ns, delay_ns
        # Of each second only the least delay matters, so a minute of poses at 1 kHz is 60 points.
        elif delay_ns < bucket[1]:
            self._bucket = bucket[0], delay_ns
        if (line := self._one_way) is None:
            self._one_way = _lower_line([(robot_ns, delay_ns)])
        else:
            below_ns = line.local(robot_ns).t_ns - arrived_ns
            if below_ns > LATE_NS:
                self._restart(Reason(ReasonCode.CLOCK_JUMPED, "the robot's clock jumped forward"))
                self._newest_ns, self._one_way = robot_ns, _lower_line([(robot_ns, delay_ns)])
            elif below_ns > 0:
                self._one_way = _lower_line([*self._buckets, (robot_ns, delay_ns)])

    def to_robot(self, local_ns: int) -> ConvertedTime | None:
        """The time of the robot's clock at a time of the daemon's;
        None while the clock is unknown.
        """
        line = self._line()
        return line.robot(local_ns) if line else None

    def state(self) -> SyncState:
        """The state at the robot's newest time."""
        line, newest_ns = self._line(), self._newest_ns
        if (off := self._stamps.found) is not None:
            return SyncState("none", Reason(ReasonCode.CLOCK_UNIT, str(off)), 0, 0.0, 0, off)
        if line is None or newest_ns is None:
            return SyncState("none", self.reason_unknown, 0, 0.0, 0)
        local = line.local(newest_ns)
        drift_ppm = 1e6 * line.slope
        reason = None
        if abs(drift_ppm) - 2e6 * line.slope_sigma > DRIFT_REPORTED_PPM:
            size, sign = round(abs(drift_ppm), -2), "slow" if drift_ppm > 0 else "fast"
            reason = Reason(
                ReasonCode.CLOCK_DRIFT, f"the robot's clock is about {size:.0f} ppm {sign}"
            )
        if (stands := self._stamps.stands) is not None:
            reason = Reason(ReasonCode.CLOCK_STANDS, str(stands))
        mode: SyncMode = "two-way" if line is self._two_way else "oneway"
        return SyncState(
            mode, reason, local.t_ns - newest_ns, round(drift_ppm, 2), round(local.error_ns / 1000)
        )

    def _line(self) -> _Line | None:
        newest_ns, two_way = self._newest_ns, self._two_way
        if self._suspect is not None or newest_ns is None:
            return None
        if two_way is not None and two_way.local(newest_ns).error_ns <= TWO_WAY_ERROR_MAX_NS:
            return two_way
        return self._one_way or two_way

    def _is_off(self, robot_ns: int, arrived_ns: int) -> bool:
        """Take a stamp; whether the robot's times pass at a rate that no clock has."""
        was_off = self._stamps.found is not None
        self._stamps.take(robot_ns, arrived_ns)
        is_off = self._stamps.found is not None
        if is_off and not was_off:
            self._restart(Reason(ReasonCode.CLOCK_UNIT, str(self._stamps.found)))
        return is_off

    def _forget(self) -> None:
        self._open = self._suspect = self._two_way = self._bucket = self._one_way = (
            self._newest_ns
        ) = None
        self._exchanges.clear()
        self._buckets.clear()

    def _advance(self, robot_ns: int) -> None:
        """Note the robot's time; a time that goes back shows that the clock was set."""
        newest_ns = self._newest_ns
        if newest_ns is not None and newest_ns - robot_ns > BACKWARDS_NS:
            exchange = self._open
            self._restart(Reason(ReasonCode.CLOCK_WENT_BACK, "the robot's clock went backwards"))
            # The SYNC that showed it is the first of the new clock.
            self._open = exchange if exchange and exchange[0] == robot_ns else None
            newest_ns = None
        self._newest_ns = robot_ns if newest_ns is None else max(robot_ns, newest_ns)

    def _add(self, exchange: _Exchange) -> None:
        self.counts.exchanges += 1
        suspect, self._suspect = self._suspect, None
        if not self._possible(exchange):
            if suspect is None:
                self._suspect = exchange
                return
            # Two in a row: the clock is wrong, not the exchange.
            latest = self._open
            self._restart(Reason(ReasonCode.CLOCK_JUMPED, "the robot's clock jumped"))
            self._open, self._newest_ns = latest, exchange.robot_ns
            if abs(exchange.offset_ns - suspect.offset_ns) <= (
                exchange.round_trip_ns + suspect.round_trip_ns
            ) / 2 + (DRIFT_EXPECTED * (exchange.robot_ns - suspect.robot_ns)):
                self._exchanges.append(suspect)
        elif suspect is not None:
            self.counts.outliers += 1
        self._exchanges.append(exchange)
        while exchange.robot_ns - self._exchanges[0].robot_ns > EXCHANGE_AGE_MAX_NS:
            self._exchanges.popleft()
        self._two_way = _fit_line(self._exchanges)

    def _possible(self, exchange: _Exchange) -> bool:
        """Whether the exchange agrees with the line so far, within half its round trip."""
        if self._two_way is None:
            return True
        local = self._two_way.local(exchange.robot_ns)
        off_ns = abs(local.t_ns - exchange.robot_ns - exchange.offset_ns)
        return off_ns <= exchange.round_trip_ns / 2 + local.error_ns + TOLERANCE_NS

    def _close_bucket(self, bucket: tuple[int, int]) -> None:
        self._buckets.append(bucket)
        latest = [*self._buckets][-LATE_BUCKETS:]
        line = self._one_way
        if len(latest) == LATE_BUCKETS and line is not None:
            late_ns = min(
                robot_ns + delay_ns - line.local(robot_ns).t_ns for robot_ns, delay_ns in latest
            )
            if late_ns > LATE_NS and self._two_way is None:
                newest_ns = self._newest_ns
                text = "the robot's clock was set back, or the serial line became slow"
                self._restart(Reason(ReasonCode.CLOCK_LATE, text))
                self._buckets.extend(latest)
                self._newest_ns = newest_ns
        self._one_way = _lower_line(self._buckets)


def _fit_line(exchanges: Sequence[_Exchange]) -> _Line:
    """Fit a line through the best exchanges by least squares;
    longer round trips get less weight.
    """
    count = max(math.ceil(len(exchanges) * BEST_FRACTION), min(len(exchanges), BEST_MIN))
    best = sorted(exchanges, key=lambda e: e.round_trip_ns)[:count]
    at_ns, base_ns = best[0].robot_ns, best[0].offset_ns
    # Relative to the best one: squares of nanoseconds since a start would exceed the digits of a
    # float.
    relative = [(e.robot_ns - at_ns, e.offset_ns - base_ns, e.round_trip_ns) for e in best]
    x, y, round_trip = np.array(relative, dtype=np.float64).T
    weights = ((round_trip - round_trip[0]) / 2 + round_trip[0] / 8 + TOLERANCE_NS) ** -2
    total = weights.sum()
    mean_x, mean_y, bound_ns = (float(weights @ v / total) for v in (x, y, round_trip / 2))
    # The prior on the drift keeps two exchanges in quick succession
    # from turning their noise into a slope.
    information = float(weights @ (x - mean_x) ** 2) + DRIFT_EXPECTED**-2
    slope = float(weights @ ((x - mean_x) * (y - mean_y))) / information
    middle = round(mean_x)
    rest_ns, sigma_ns = mean_y + slope * (middle - mean_x), float(total) ** -0.5
    return _Line(
        at_ns + middle,
        base_ns,
        rest_ns,
        slope,
        information**-0.5,
        sigma_ns,
        bound_ns + TOLERANCE_NS,
    )


def _lower_line(points: Sequence[tuple[int, int]]) -> _Line:
    """Fit the closest line under all delays: the edge
    of their lower convex hull at their mean time.

    It has the least sum of distances (Moon et al. 1999); the hull is Andrew's monotone chain.
    """
    first_ns, base_ns = points[0]
    placed = [(float(t_ns - first_ns), float(delay_ns - base_ns)) for t_ns, delay_ns in points]
    hull: list[tuple[float, float]] = []
    for x, y in placed:
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2:]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):  # a turn to the left
                break
            hull.pop()
        hull.append((x, y))
    middle = sum(x for x, _ in placed) / len(placed)
    at = next((i for i in range(1, len(hull)) if hull[i][0] >= middle), 0)
    (x0, y0), (x1, y1) = hull[max(at - 1, 0)], hull[at]
    span = x1 - x0
    # Below ten seconds, the slope of an envelope is the noise of two arrivals.
    slope = (
        max(-DRIFT_EXPECTED, min(DRIFT_EXPECTED, (y1 - y0) / span))
        if span >= 10 * BUCKET_NS
        else 0.0
    )
    rest = min(y - slope * x for x, y in placed)
    above = sorted(y - slope * x - rest for x, y in placed)
    spread = above[len(above) // 2]
    slope_sigma = max(spread, TOLERANCE_NS) / max(placed[-1][0], BUCKET_NS)
    return _Line(
        first_ns,
        base_ns,
        rest,
        slope,
        min(slope_sigma, DRIFT_EXPECTED),
        0.0,
        spread + ONE_WAY_LATENCY_NS,
    )
