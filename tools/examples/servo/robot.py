"""The interface to a robot that takes velocities: put your robot here.

This one sends ``vx vy vz wx wy wz`` by UDP, in mm/s and °/s of the sensor's tip, along and about
the sensor's axes. The robot's tool frame must be the sensor frame, moved along z to the tip.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Sequence
from types import TracebackType

STOP_S = 0.1
"""The robot stops after this time without a touch."""
STANDSTILL = (0.0,) * 6


class Robot:
    """At ``HOST:PORT``; moves as long as `move` is called,
    and stops `STOP_S` after the last call or at the end.
    """

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        self._line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._line.connect((host, int(port)))
        self._moved, self._ends = threading.Event(), threading.Event()
        self._watch = threading.Thread(target=self._stop_when_silent, name="stop")

    def __enter__(self) -> Robot:
        self._watch.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ends.set()
        self._moved.set()
        self._watch.join()
        self._line.close()

    def move(self, velocity: Sequence[float]) -> None:
        """Move with this velocity, (6,), in mm/s and °/s."""
        self._send(velocity)
        self._moved.set()

    def _send(self, velocity: Sequence[float]) -> None:
        self._line.send(" ".join(f"{v:.5f}" for v in velocity).encode())

    def _stop_when_silent(self) -> None:
        while not self._ends.is_set():
            if not self._moved.wait(STOP_S):
                self._send(STANDSTILL)
            self._moved.clear()
        self._send(STANDSTILL)
