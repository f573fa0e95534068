"""A robot's places against what the sensor feels on the way: whether they are in mm.

As a robot presses, the sensor goes as much deeper as the robot moves on. Where depths go with a
motion of a thousandth, in one press after another, and all places lie within a few mm, the places
are in m. A robot that stands while something else presses, or trembles, moves no farther between
touches than in them.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from tacshade_edge.plausibility.suspicions import Suspicion, SuspicionCode, suspicion
from tacshade_edge.plausibility.units import LENGTHS, UnitName, nearest
from tacshade_edge.types import F64

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


class StreamPlaces:
    """The places of one sensor's frames, in their order; for one thread, but for `found`."""

    def __init__(self, size_mm: float) -> None:
        self.found: Suspicion | None = None
        self._depth_least_mm = _DEPTH_LEAST * size_mm
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)
        self._press: list[tuple[F64, float]] = []
        self._presses: deque[tuple[float, float]] = deque(maxlen=PRESSES)
        self._anchor: tuple[F64, int] | None = None
        self._speeds: deque[float] = deque(maxlen=WINDOWS)

    def take(self, place_mm: tuple[float, float, float], t_ns: int, depth_mm: float | None) -> None:
        """Take the place at a frame, and how deep it shows a press; None without contact."""
        at = np.array(place_mm)
        self._low, self._high = np.minimum(self._low, at), np.maximum(self._high, at)
        self._time(at, t_ns)
        if self._span() > SPAN_M_MAX:
            self._forgive(SuspicionCode.PLACES_SMALL)
        if depth_mm is None:
            press, self._press = self._press, []
            self._judge(press)
        elif len(self._press) < _SAMPLES_MOST:
            self._press.append((at, depth_mm))

    def _judge(self, press: list[tuple[F64, float]]) -> None:
        """Judge a press that has ended."""
        if len(press) < SAMPLES_LEAST:
            return
        depth = np.array([depth_mm for _, depth_mm in press])
        if np.ptp(depth) < self._depth_least_mm:
            return
        at = np.array([at for at, _ in press])
        at -= at.mean(axis=0)
        along = at @ np.linalg.svd(at, full_matrices=False)[2][0]
        depth -= depth.mean()
        size = math.sqrt((along @ along) * (depth @ depth))
        if not size > 0 or abs(float(along @ depth)) < _TOGETHER * size:
            return
        factor = math.sqrt((depth @ depth) / (along @ along))
        if 1 / _RIGHT_WITHIN < factor < _RIGHT_WITHIN:
            self._forgive(SuspicionCode.PLACES_SMALL)
            return
        self._presses.append((factor, float(np.ptp(along))))
        span = self._span()
        if (
            len(self._presses) == PRESSES
            and all(_is_metres(factor) for factor, _ in self._presses)
            and _BETWEEN * max(moved for _, moved in self._presses) <= span <= SPAN_M_MAX
        ):
            self.found = suspicion(
                SuspicionCode.PLACES_SMALL,
                impossible=True,
                span_mm=span,
                factor=factor,
                unit=UnitName.M,
            )

    def _time(self, at: F64, t_ns: int) -> None:
        """Judge how fast the robot seems to move."""
        if self._anchor is None or t_ns < self._anchor[1]:
            self._anchor = at, t_ns
            return
        at0, t0_ns = self._anchor
        if t_ns - t0_ns < WINDOW_NS:
            return
        self._anchor = at, t_ns
        speed_mm_s = float(np.linalg.norm(at - at0)) / ((t_ns - t0_ns) / 1e9)
        if speed_mm_s < _MOVES_MM_S:
            return
        self._speeds.append(speed_mm_s)
        is_fast = len(self._speeds) == WINDOWS and min(self._speeds) > SPEED_MAX_MM_S
        if is_fast:
            self.found = suspicion(
                SuspicionCode.PLACES_FAST,
                impossible=True,
                speed_m_s=min(self._speeds) / 1e3,
                span_mm=self._span(),
                unit=UnitName.MICROMETRE,
            )
        elif max(self._speeds) <= SPEED_MAX_MM_S:
            self._forgive(SuspicionCode.PLACES_FAST)

    def _forgive(self, code: SuspicionCode) -> None:
        """Drop a suspicion that what came since contradicts."""
        if code is SuspicionCode.PLACES_SMALL:
            self._presses.clear()
        if self.found is not None and self.found.code is code:
            self.found = None

    def _span(self) -> float:
        return float((self._high - self._low).max())


def _is_metres(factor: float) -> bool:
    return nearest(factor, LENGTHS, _UNIT_WITHIN) is UnitName.M
