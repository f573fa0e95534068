#!/usr/bin/env python3
"""Which references does `calibrate` refuse as pressed: honest ones, and those with a press of 2 mm?

::

    .venv/bin/python -m tools.studies.loads [--sensors 30] [--first 8300] [--depth 2]

Every sensor gives one reference alone: untouched, under a ball of 6 mm in the middle, under the
ball 6 mm from it, and under a plate, on the nominal skin. `real_frames SET FOLDER --references N`
does the same with real frames.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator

import numpy as np

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball
from tacshade_edge.lab.simulator.sensor_model import random_model, tactip
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.lab.studies.evaluate.work import PressedSensor, tacshade
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.types import U8
from tools.testbed.simulator.families import other, square


def tactip_sensor(seed: int) -> SimulatedSensor:
    """Make a TacTip whose sizes are those of a random TacShade."""
    return SimulatedSensor(tactip(random_model(seed)))


SHOWN: dict[str, Callable[[int], PressedSensor]] = {
    "tacshade": tacshade,
    "other": other,
    "square": square,
    "tactip": tactip_sensor,
}
BALL_MM, BESIDE_MM = 6.0, 6.0
COLUMNS = (
    "family",
    "sensors",
    "untouched, refused",
    "ball in the middle",
    "ball beside it",
    "plate",
)


def is_refused(sensor: PressedSensor, image: U8) -> bool:
    """Whether `calibrate` refuses an image as the only reference."""
    of = sensor.model.geometry
    stated = StatedSensor(of.skin_radius_mm, of.camera_distance_mm, of.visible_half_angle_deg, None)
    try:
        calibrate(stated, [image])
    except ConfigError:
        return True
    return False


def presses(sensor: PressedSensor, depth_mm: float, seed: int) -> Iterator[tuple[Press, ...]]:
    """What touches the sensor in each picture."""
    scale = skin_scale(sensor.model.geometry)
    angle = np.random.default_rng(seed).uniform(0, 2 * math.pi)
    x_mm, y_mm = (scale * BESIDE_MM * turn(angle) for turn in (math.cos, math.sin))
    depth_mm *= scale
    yield ()
    yield (Press(ball(BALL_MM * scale), 0.0, 0.0, depth_mm),)
    yield (Press(ball(BALL_MM * scale), x_mm, y_mm, depth_mm),)
    yield (Press(OBJECTS["plate"](), 0.0, 0.0, depth_mm, scale=scale),)


def refused(family: str, seed: int, depth_mm: float) -> list[bool]:
    """Which of a sensor's pictures are refused."""
    sensor = SHOWN[family](seed)
    return [
        is_refused(sensor, sensor.frame(some, noise_seed=seed).image)
        for some in presses(sensor, depth_mm, seed)
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensors", type=int, default=30, help="of each family (30)")
    parser.add_argument("--first", type=int, default=8300, help="the first seed (8300)")
    parser.add_argument("--depth", type=float, default=2.0, metavar="MM", help="of a press (2)")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.sensors)
    lines = []
    for family in SHOWN:
        counts = np.sum([refused(family, seed, args.depth) for seed in seeds], axis=0)
        lines.append((family, str(len(seeds)), *(str(count) for count in counts)))
    print(markdown(COLUMNS, lines))


if __name__ == "__main__":
    main()
