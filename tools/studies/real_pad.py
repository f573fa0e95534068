#!/usr/bin/env python3
"""Raw pictures of a real sensor that its owner calls a pad, stated as one.

::

    .venv/bin/python -m tools.studies.real_pad FOLDER [--frames 400]

The set, its labels and the tables are those of ``real_frames tilted FOLDER``, which states a dome.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace

from tacshade_edge.calibration.inputs import StatedSensor
from tools.studies import real_frames
from tools.studies.real_sets import SENSORS

SET = "tilted"


def as_pad(sensor: StatedSensor) -> StatedSensor:
    """A flat skin with the visible circle of a dome, and its lens as far from the circle."""
    half, r = math.radians(sensor.visible_half_angle_deg), sensor.skin_radius_mm
    d = sensor.camera_distance_mm
    return replace(
        sensor,
        skin_radius_mm=math.inf,
        visible_half_angle_deg=0.0,
        pad_radius_mm=r * math.sin(half),
        camera_distance_mm=None if d is None else d + r * math.cos(half),
    )


def main() -> int:
    """Measure and print."""
    SENSORS[SET] = as_pad(SENSORS[SET])
    sys.argv.insert(1, SET)
    return real_frames.main()


if __name__ == "__main__":
    sys.exit(main())
