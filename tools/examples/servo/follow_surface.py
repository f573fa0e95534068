#!/usr/bin/env python3
"""Move along a surface at a set depth and at right angles to it.

::

    .venv/bin/python -m tools.examples.servo.follow_surface localhost:1883 left-index
        --robot 192.168.1.5:30000

Begin with the sensor on the surface; the sensor moves along its own x.
Read README.md before a real robot moves.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping

from tools.examples.servo.running import Loop, Velocity, options, run

NAMES = ("depth_mm", "tilt_x_deg", "tilt_y_deg")
LIMIT_MM_S, LIMIT_DEG_S = 20.0, 30.0


class FollowSurface:
    """Computes the robot's velocity from a touch: it keeps a depth,
    at a speed along the sensor's x.
    """

    def __init__(self, depth_mm: float, speed_mm_s: float) -> None:
        self._depth_mm, self._speed_mm_s = depth_mm, speed_mm_s
        self._down, self._about_x, self._about_y = (
            Loop(LIMIT_MM_S),
            Loop(LIMIT_DEG_S),
            Loop(LIMIT_DEG_S),
        )

    def velocity(self, touch: Mapping[str, float], dt_s: float) -> Velocity:
        """Move along the surface and towards the depth along z,
        and turn with the surface's tilt.
        """
        along = -self._speed_mm_s * math.tan(math.radians(touch["tilt_y_deg"]))
        down = along + self._down.velocity(self._depth_mm - touch["depth_mm"], dt_s)
        about_x = self._about_x.velocity(touch["tilt_x_deg"], dt_s)
        about_y = self._about_y.velocity(touch["tilt_y_deg"], dt_s)
        return (self._speed_mm_s, 0.0, down, about_x, about_y, 0.0)


def main() -> int:
    """Follow the surface until Ctrl-C, or for ``--seconds``."""
    args = options(__doc__).parse_args()
    return run(args, NAMES, FollowSurface(args.depth_mm, args.speed_mm_s).velocity)


if __name__ == "__main__":
    sys.exit(main())
