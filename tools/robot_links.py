"""How long bytes take between a robot and the daemon: the lines that the clock's synchronisation is measured on.

Delays in seconds, each way. The shapes are what the hardware does; the sizes are the field's.
"""

from __future__ import annotations

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
