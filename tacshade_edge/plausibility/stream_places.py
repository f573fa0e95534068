"""A robot's places against what the sensor feels on the way: whether they are in mm.

As a robot presses, the sensor goes as much deeper as the robot moves on. Where depths go with a
motion of a thousandth, in one press after another, and all places lie within a few mm, the places
are in m. A robot that stands while something else presses, or trembles, moves no farther between
touches than in them.

Places in cm or inches span as much as those of a smaller robot in mm. So depths that go with a
tenth of their motion count only if the robot itself presses: it comes straight on as fast as it
goes deeper, and does not turn, which would move a sensor at the end of a lever.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from tacshade_edge.plausibility.suspicions import Suspicion, SuspicionCode, suspicion
from tacshade_edge.plausibility.units import LENGTHS, UnitName, nearest

PRESSES: Final = 3
"""So many presses in a row must agree."""
SPAN_M_MAX: Final = 5.0
"""No arm reaches farther, so that places in m span less than as many "mm"."""
SPEED_MAX_MM_S: Final = 20_000.0
"""No robot moves a sensor faster for long; one whose places are in µm seems to."""
WINDOW_NS: Final = 500_000_000
WINDOWS: Final = 4
SAMPLES_LEAST: Final = 8
"""Of fewer frames of a press, nothing follows."""
_SAMPLES_MOST: Final = 1024
_TOGETHER: Final = 0.8
_DEPTH_LEAST: Final = 0.02  # of the sensor's size
_UNIT_WITHIN: Final = 2.0
_RIGHT_WITHIN: Final = 5.0
# Between presses a robot moves at least this many times as far as in them.
_BETWEEN: Final = 3.0
_MOVES_MM_S: Final = 100.0
# A robot that presses by itself has come on in the latest so many frames, before which it may have
# done something else, within this factor of its speed in the press, and in its direction, by the
# cosine.
_COMING: Final = (3, 5, 8)
_AS_FAST: Final = 2.0
_STRAIGHT: Final = 0.95
# It turns so little that a lever of a metre adds only this part to the depth.
_LEVER_MM, _LEVER_PART = 1000.0, 0.3
# Depths over motions of places in cm or inches, as found with poor calibrations, and how much those
# of one robot may differ.
_TENTHS: Final = (5.0, 45.0)
_ALIKE: Final = 1.6
_SHORT: Final = (UnitName.CM, UnitName.INCH)


Place = tuple[float, float, float]
Facing = tuple[float, float, float, float]
"""A unit quaternion, w, x, y, z."""
Velocity = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class _Sample:
    """Where a robot was at a frame, and how deep its sensor was pressed."""

    place: Place
    t_ns: int
    depth_mm: float
    facing: Facing | None


class _Box:
    """The least box that holds some places; `span` is its longest side."""

    def __init__(self) -> None:
        self.span = 0.0
        self._low: list[float] = []
        self._high: list[float] = []

    def take(self, at: Place) -> None:
        if not self._low:
            self._low, self._high = list(at), list(at)
        for k, value in enumerate(at):
            if value < self._low[k]:
                self._low[k] = value
            elif value > self._high[k]:
                self._high[k] = value
        self.span = max(high - low for low, high in zip(self._low, self._high, strict=True))


class StreamPlaces:
    """The places of one sensor's frames, in their order; for one thread, but for `found`."""

    def __init__(self, size_mm: float) -> None:
        self.found: Suspicion | None = None
        self._depth_least_mm = _DEPTH_LEAST * size_mm
        self._all, self._free = _Box(), _Box()
        self._coming: deque[_Sample] = deque(maxlen=max(_COMING))
        self._press: list[_Sample] = []
        self._presses: deque[tuple[float, float]] = deque(maxlen=PRESSES)
        self._own_presses: deque[float] = deque(maxlen=PRESSES)
        self._anchor: tuple[Place, int] | None = None
        self._speeds: deque[float] = deque(maxlen=WINDOWS)

    def take(
        self, place_mm: Place, t_ns: int, depth_mm: float | None, facing: Facing | None = None
    ) -> None:
        """Take the place at a frame, and how deep it shows a press; None without contact."""
        self._all.take(place_mm)
        self._time(place_mm, t_ns)
        if self._all.span > SPAN_M_MAX:
            self._forgive(SuspicionCode.PLACES_SMALL)
        sample = _Sample(place_mm, t_ns, depth_mm or 0.0, facing)
        if depth_mm is None:
            self._free.take(place_mm)
            press, self._press = self._press, []
            self._judge(press)
            if press:
                self._coming.clear()
            self._coming.append(sample)
        elif len(self._press) < _SAMPLES_MOST:
            self._press.append(sample)

    def _judge(self, press: list[_Sample]) -> None:
        """Judge a press that has ended."""
        if len(press) < SAMPLES_LEAST:
            return
        depth = np.array([one.depth_mm for one in press])
        if np.ptp(depth) < self._depth_least_mm:
            return
        at = np.array([one.place for one in press])
        at -= at.mean(axis=0)
        along = at @ np.linalg.svd(at, full_matrices=False)[2][0]
        depth -= depth.mean()
        size = math.sqrt((along @ along) * (depth @ depth))
        if not size > 0 or abs(float(along @ depth)) < _TOGETHER * size:
            return
        factor = math.sqrt((depth @ depth) / (along @ along))
        if 1 / _RIGHT_WITHIN < factor < _RIGHT_WITHIN:
            self._forgive(SuspicionCode.PLACES_SMALL)
            self._forgive(SuspicionCode.PLACES_SHORT)
            return
        self._presses.append((factor, float(np.ptp(along))))
        if self._is_metres():
            self.found = suspicion(
                SuspicionCode.PLACES_SMALL,
                impossible=True,
                span_mm=self._all.span,
                factor=factor,
                unit=UnitName.M,
            )
        elif _is_own(self._coming, press):
            self._judge_own(factor)

    def _is_metres(self) -> bool:
        between_mm = _BETWEEN * max(moved for _, moved in self._presses)
        return (
            len(self._presses) == PRESSES
            and all(_is_metres(factor) for factor, _ in self._presses)
            and between_mm <= self._free.span
            and self._all.span <= SPAN_M_MAX
        )

    def _judge_own(self, factor: float) -> None:
        """Judge the motion of a press that the robot itself makes."""
        self._own_presses.append(factor)
        least, most = min(self._own_presses), max(self._own_presses)
        if (
            len(self._own_presses) == PRESSES
            and _TENTHS[0] <= least
            and most <= min(_TENTHS[1], _ALIKE * least)
        ):
            self.found = suspicion(
                SuspicionCode.PLACES_SHORT,
                span_mm=self._all.span,
                factor=factor,
                unit=nearest(factor, {unit: LENGTHS[unit] for unit in _SHORT}),
            )

    def _time(self, at: Place, t_ns: int) -> None:
        """Judge how fast the robot seems to move."""
        if self._anchor is None or t_ns < self._anchor[1]:
            self._anchor = at, t_ns
            return
        at0, t0_ns = self._anchor
        if t_ns - t0_ns < WINDOW_NS:
            return
        self._anchor = at, t_ns
        speed_mm_s = math.dist(at, at0) / ((t_ns - t0_ns) / 1e9)
        if speed_mm_s < _MOVES_MM_S:
            return
        self._speeds.append(speed_mm_s)
        is_fast = len(self._speeds) == WINDOWS and min(self._speeds) > SPEED_MAX_MM_S
        if is_fast:
            self.found = suspicion(
                SuspicionCode.PLACES_FAST,
                impossible=True,
                speed_m_s=min(self._speeds) / 1e3,
                span_mm=self._all.span,
                unit=UnitName.MICROMETRE,
            )
        elif max(self._speeds) <= SPEED_MAX_MM_S:
            self._forgive(SuspicionCode.PLACES_FAST)

    def _forgive(self, code: SuspicionCode) -> None:
        """Drop a suspicion that what came since contradicts."""
        if code is SuspicionCode.PLACES_SMALL:
            self._presses.clear()
        if code is SuspicionCode.PLACES_SHORT:
            self._own_presses.clear()
        if self.found is not None and self.found.code is code:
            self.found = None


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return sum(a * b for a, b in zip(one, other, strict=True))


def _is_metres(factor: float) -> bool:
    return nearest(factor, LENGTHS, _UNIT_WITHIN) is UnitName.M


def _is_own(coming: Sequence[_Sample], press: Sequence[_Sample]) -> bool:
    """Whether the robot itself has made a press: it came straight on, and did not turn."""
    deepest = max(range(len(press)), key=lambda k: press[k].depth_mm)
    into = _velocity(press[0], press[deepest])
    ways = (_velocity(coming[-many], coming[-1]) for many in _COMING if many <= len(coming))
    if not any(_is_straight(before, into) for before in ways):
        return False
    first, last = press[0].facing, press[deepest].facing
    if first is None or last is None:
        return False
    turned = 2 * math.acos(min(1.0, abs(_dot(first, last))))
    return turned * _LEVER_MM <= _LEVER_PART * (press[deepest].depth_mm - press[0].depth_mm)


def _is_straight(before: Velocity, after: Velocity) -> bool:
    speeds = math.hypot(*before), math.hypot(*after)
    is_as_fast = min(speeds) * _AS_FAST >= max(speeds) > 0
    return is_as_fast and _dot(before, after) >= _STRAIGHT * speeds[0] * speeds[1]


def _velocity(one: _Sample, other: _Sample) -> Velocity:
    """In mm/s, of places in mm; 0 in no time."""
    t_s = (other.t_ns - one.t_ns) / 1e9
    if not t_s > 0:
        return (0.0, 0.0, 0.0)
    return tuple((b - a) / t_s for a, b in zip(one.place, other.place, strict=True))
