#!/usr/bin/env python3
"""Follow a plate's edge at a set depth, and keep the edge under the tip and along the sensor's x.

::

    .venv/bin/python -m tools.examples.servo.follow_edge localhost:1883 left-index
        --robot 192.168.1.5:30000

The program needs labels of edges: `y_mm`, where the edge crosses the sensor's y axis, and
`edge_deg`, the edge's direction from x towards y. Begin with the tip on the edge, at right angles
to the plate, with the edge within 25° of the sensor's x. Read README.md before a real robot moves.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping

from tools.examples.servo.running import Loop, Velocity, options, run

NAMES = ("depth_mm", "y_mm", "edge_deg")
LIMIT_MM_S, LIMIT_DEG_S = 20.0, 30.0


class FollowEdge:
    """Computes the robot's velocity from a touch: it keeps a depth,
    at a speed along the sensor's x.
    """

    def __init__(self, depth_mm: float, speed_mm_s: float) -> None:
        self._depth_mm, self._speed_mm_s = depth_mm, speed_mm_s
        self._down, self._across, self._about_z = (
            Loop(LIMIT_MM_S),
            Loop(LIMIT_MM_S),
            Loop(LIMIT_DEG_S),
        )

    def velocity(self, touch: Mapping[str, float], dt_s: float) -> Velocity:
        """Move along the edge, towards the edge along y and the depth along z,
        and turn with the edge.
        """
        along = self._speed_mm_s * math.tan(math.radians(touch["edge_deg"]))
        down = self._down.velocity(self._depth_mm - touch["depth_mm"], dt_s)
        across = along + self._across.velocity(touch["y_mm"], dt_s)
        about_z = self._about_z.velocity(touch["edge_deg"], dt_s)
        return (self._speed_mm_s, across, down, 0.0, 0.0, about_z)


def main() -> int:
    """Follow the edge until Ctrl-C, or for ``--seconds``."""
    args = options(__doc__).parse_args()
    return run(args, NAMES, FollowEdge(args.depth_mm, args.speed_mm_s).velocity)


if __name__ == "__main__":
    sys.exit(main())
