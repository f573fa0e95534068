"""What disturbs a frame in normal use and beyond it, by name."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from support import bad_pictures
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.press import Press, ball
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.studies.evaluate.work import PressedSensor
from tacshade_edge.types import U8
from tools.testbed.simulator.families import released

Rng = np.random.Generator
Change = Callable[[U8, SensorModel, Rng], U8]

UNDISTURBED = "nothing"
RELEASED = "after a release"
"""Nothing touches, but the skin keeps 2 to 10 % of the dent
(up to 0.4 mm) of a ball pressed 2 to 4 mm deep.
"""
LEFT = (0.02, 0.1)


def _glare(image: U8, model: SensorModel, rng: Rng) -> U8:
    rho, angle = 0.9 * model.disc_radius_px * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
    sigma, level = float(rng.uniform(2, 20)), float(rng.uniform(60, 255))
    row, col = model.row_c + rho * math.sin(angle), model.col_c + rho * math.cos(angle)
    return camera_faults.glare(image, row, col, sigma, level)


def _aged(image: U8, model: SensorModel, rng: Rng) -> U8:
    loss, angle = float(rng.uniform(0.1, 0.4)), float(rng.uniform(0, 360))
    return camera_faults.uneven(image, model.row_c, model.col_c, model.disc_radius_px, loss, angle)


def _noisy(low: float, high: float) -> Change:
    return lambda image, _, rng: camera_faults.noise(
        image, float(rng.uniform(low, high)), int(rng.integers(1 << 30))
    )


CHANGES: dict[str, Change] = {
    UNDISTURBED: lambda image, model, rng: image,
    "light within 20 %": lambda image, _, rng: camera_faults.gain(
        image, float(rng.uniform(0.8, 1.2))
    ),
    "one side dims by 10 to 40 %": _aged,
    "glare spot": _glare,
    "warm-up": lambda image, m, rng: bad_pictures.warm(
        image, m.row_c, m.col_c, float(rng.uniform(0, 1))
    ),
    "moved by 1 px": lambda image, _, rng: camera_faults.shift(
        image, *((1, 0), (-1, 0), (0, 1), (0, -1))[rng.integers(4)]
    ),
    "noise of 2 to 10 levels": _noisy(2, 10),
}
"""Changes of an image, by name.

Glare has a standard deviation of 2 to 20 px and 60 to 255 levels.
"""


def _far_light(image: U8, model: SensorModel, rng: Rng) -> U8:
    return camera_faults.gain(image, float(rng.choice((0.3, 0.5, 0.7, 1.3, 1.5, 2.0, 3.0))))


def _far_moved(image: U8, model: SensorModel, rng: Rng) -> U8:
    rows, cols = (int(rng.choice((-1, 1)) * rng.integers(2, 6)) for _ in range(2))
    return camera_faults.shift(image, rows, cols)


def _torn_row(model: SensorModel, rng: Rng) -> int:
    return round(
        model.row_c + model.disc_radius_px * float(rng.choice((-0.6, -0.3, 0.0, 0.3, 0.6)))
    )


def _sideways(px: int) -> Change:
    def change(image: U8, model: SensorModel, rng: Rng) -> U8:
        scaled_px = round(px * model.image_width_px / 640)
        return bad_pictures.torn(
            image, image, _torn_row(model, rng), scaled_px * int(rng.choice((-1, 1)))
        )

    return change


def _repeated(image: U8, model: SensorModel, rng: Rng) -> U8:
    row = _torn_row(model, rng)
    return np.concatenate((image[:row], np.broadcast_to(image[row], image[row:].shape)))


def _down(image: U8, model: SensorModel, rng: Rng) -> U8:
    row, px = _torn_row(model, rng), round(40 * model.image_height_px / 480)
    return np.concatenate((image[:row], image[row - px : len(image) - px]))


def _flat_below(image: U8, model: SensorModel, rng: Rng) -> U8:
    return bad_pictures.torn(
        image, np.full_like(image, int(rng.choice((0, 128)))), _torn_row(model, rng)
    )


BEYOND: dict[str, Change] = {
    "light x0.3 to x3": _far_light,
    "moved by 3 to 7 px": _far_moved,
    "noise of 15 to 50 levels": _noisy(15, 50),
    "blur of 1 to 5 px": lambda image, _, rng: bad_pictures.defocus(
        image, float(rng.uniform(1, 5))
    ),
    "torn: rows sideways by 60 px": _sideways(60),
    "torn: rows sideways by 200 px": _sideways(200),
    "torn: one row again and again": _repeated,
    "torn: rows down by 40 px": _down,
    "torn: black or grey below": _flat_below,
}
"""Disturbances that are not compensated; at best, the result is invalid or degraded.

A tear begins at one of five rows, and pixels are those of a 640x480 image.
"""


def without_contact(sensor: PressedSensor, what: str, seed: int, noise_seed: int) -> U8:
    """Take an image without contact, disturbed by `CHANGES`, `RELEASED` or `BEYOND`,
    drawn from the seed.
    """
    rng = np.random.default_rng((seed, 31))
    if what == RELEASED:
        model = sensor.model
        rho, angle = model.skin_radius_mm * rng.uniform(0, 0.4), rng.uniform(0, 2 * math.pi)
        radius, depth, part = rng.uniform(3, 9), rng.uniform(2, 4), rng.uniform(*LEFT)
        press = Press(ball(radius), rho * math.cos(angle), rho * math.sin(angle), depth)
        return released(sensor, (press,), part, noise_seed).image
    return (CHANGES | BEYOND)[what](sensor.frame((), noise_seed).image, sensor.model, rng)
