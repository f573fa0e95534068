"""A robot's clock, and how long its bytes take to the daemon and back: what synchronisation is measured on.

Delays in seconds, each way. The shapes are what the hardware does; the sizes are the field's.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

Delay = Callable[[random.Random], float]


@dataclass(frozen=True, slots=True)
class LineModel:
    """A kind of line: towards the daemon, and back to the robot."""

    to_daemon_s: Delay
    to_robot_s: Delay


def _usb(rng: random.Random) -> float:
    """The host asks each millisecond, in a part of it that wanders; then the kernel wakes the reader."""
    return 0.0001 + rng.uniform(0, 0.001) + rng.expovariate(1 / 0.00005)


def _loaded(rng: random.Random) -> float:
    """The same on a board whose cores are all busy: the scheduler's slices on top, now and then many."""
    return _usb(rng) + rng.expovariate(1 / 0.001) + (rng.uniform(0.005, 0.03) if rng.random() < 0.05 else 0)


def _ftdi(rng: random.Random) -> float:
    """The chip sends what it holds every 16 ms, whenever it came."""
    return 0.0002 + rng.uniform(0, 0.016) + rng.expovariate(1 / 0.00005)


LINES = {
    "usb": LineModel(_usb, _usb),
    "loaded": LineModel(_loaded, _loaded),
    "ftdi": LineModel(_ftdi, _usb),
}


class Clock:
    """The robot's: an offset, a drift, and a wander of it by a ppm over ten minutes."""

    def __init__(self, offset_s: float, drift_ppm: float) -> None:
        self._offset_s, self._drift = offset_s, drift_ppm * 1e-6

    def read_ns(self, true_s: float) -> int:
        """Its time at a true one."""
        wander_s = 1e-6 * 600 / math.tau * (1 - math.cos(true_s * math.tau / 600))
        return round(1e9 * (self._offset_s + true_s * (1 + self._drift) + wander_s))
