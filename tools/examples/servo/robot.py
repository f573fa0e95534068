"""A robot that takes velocities: put yours here.

This one sends ``vx vy vz wx wy wz`` by UDP, mm/s and °/s of the sensor's tip, along and about the sensor's axes. The
sensor's frame must be the robot's tool frame, moved along z to the tip.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Sequence
from types import TracebackType

STOP_S = 0.1
"""Without a touch for so long the robot stops."""
STANDSTILL = (0.0,) * 6


class Robot:
    """Moves while it is told to again and again, and stops when it was not for `STOP_S`, or when it is left.

    Parameters
    ----------
    address : str
        ``HOST:PORT``.
    """

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        self._line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._line.connect((host, int(port)))
        self._told, self._ends = threading.Event(), threading.Event()
        self._watch = threading.Thread(target=self._stop_when_silent, name="stop")

    def __enter__(self) -> Robot:
        self._watch.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ends.set()
        self._told.set()
        self._watch.join()
        self._line.close()

    def move(self, velocity: Sequence[float]) -> None:
        """Go on with this velocity: mm/s and °/s, (6,)."""
        self._send(velocity)
        self._told.set()

    def _send(self, velocity: Sequence[float]) -> None:
        self._line.send(" ".join(f"{v:.5f}" for v in velocity).encode())

    def _stop_when_silent(self) -> None:
        while not self._ends.is_set():
            if not self._told.wait(STOP_S):
                self._send(STANDSTILL)
            self._told.clear()
        self._send(STANDSTILL)
