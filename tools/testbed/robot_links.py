"""A robot's clock, and how long its bytes take to the daemon and back: the test cases of clock synchronisation.

Delays are in seconds, each way. Their shapes follow the hardware; their sizes are typical of the field.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

Delay = Callable[[random.Random], float]


@dataclass(frozen=True, slots=True)
class LineModel:
    """A kind of line: its delays towards the daemon and back to the robot."""

    to_daemon_s: Delay
    to_robot_s: Delay


def _usb(rng: random.Random) -> float:
    """The host polls every millisecond, at a phase that wanders; then the kernel wakes the reader."""
    return 0.0001 + rng.uniform(0, 0.001) + rng.expovariate(1 / 0.00005)


def _loaded(rng: random.Random) -> float:
    """The same on a board whose cores are all busy: the scheduler's slices on top, now and then many."""
    return _usb(rng) + rng.expovariate(1 / 0.001) + (rng.uniform(0.005, 0.03) if rng.random() < 0.05 else 0)


def _ftdi(rng: random.Random) -> float:
    """The chip sends its buffer every 16 ms, whenever the bytes came."""
    return 0.0002 + rng.uniform(0, 0.016) + rng.expovariate(1 / 0.00005)


LINES = {
    "usb": LineModel(_usb, _usb),
    "loaded": LineModel(_loaded, _loaded),
    "ftdi": LineModel(_ftdi, _usb),
}


class Clock:
    """The robot's clock: an offset, and a drift that wanders by a ppm over ten minutes."""

    def __init__(self, offset_s: float, drift_ppm: float) -> None:
        self._offset_s, self._drift = offset_s, drift_ppm * 1e-6

    def read_ns(self, true_s: float) -> int:
        """The clock's reading in ns at a true time in s."""
        wander_s = 1e-6 * 600 / math.tau * (1 - math.cos(true_s * math.tau / 600))
        return round(1e9 * (self._offset_s + true_s * (1 + self._drift) + wander_s))
