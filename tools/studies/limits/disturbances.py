"""Disturbances of a sensor in use, drawn at random within stated bounds, without and with a contact."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tacshade_edge.simulator import camera_faults, nuisance
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.studies.evaluate.sensors import PressedSensor
from tacshade_edge.types import U8
from tools.testbed.simulator.variants import released

Rng = np.random.Generator
Change = Callable[[U8, SensorModel, Rng], U8]

UNDISTURBED = "nothing"
RELEASED = "after a release"
"""Nothing touches, but the skin keeps 2 to 10 % of the dent (up to 0.4 mm) of a ball pressed 2 to 4 mm deep."""
LEFT = (0.02, 0.1)


def _light(image: U8, model: SensorModel, rng: Rng) -> U8:
    return nuisance.gain(image, float(rng.uniform(0.8, 1.2)))


def _aged(image: U8, model: SensorModel, rng: Rng) -> U8:
    loss, angle = float(rng.uniform(0.1, 0.4)), float(rng.uniform(0, 360))
    return camera_faults.uneven(image, model.row_c, model.col_c, model.disc_radius_px, loss, angle)


def _glare(image: U8, model: SensorModel, rng: Rng) -> U8:
    rho, angle = 0.9 * model.disc_radius_px * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
    sigma, level = float(rng.uniform(2, 20)), float(rng.uniform(60, 255))
    return camera_faults.glare(
        image, model.row_c + rho * math.sin(angle), model.col_c + rho * math.cos(angle), sigma, level
    )


def _warm(image: U8, model: SensorModel, rng: Rng) -> U8:
    return camera_faults.warm(image, model.row_c, model.col_c, float(rng.uniform(0, 1)))


def _moved(image: U8, model: SensorModel, rng: Rng) -> U8:
    rows, cols = ((1, 0), (-1, 0), (0, 1), (0, -1))[rng.integers(4)]
    return nuisance.shift(image, rows, cols)


def _noisy(image: U8, model: SensorModel, rng: Rng) -> U8:
    return camera_faults.noise(image, float(rng.uniform(2, 10)), int(rng.integers(1 << 30)))


CHANGES: dict[str, Change] = {
    UNDISTURBED: lambda image, model, rng: image,
    "light within 20 %": _light,
    "one side dims by 10 to 40 %": _aged,
    "glare spot": _glare,
    "warm-up": _warm,
    "moved by 1 px": _moved,
    "noise of 2 to 10 levels": _noisy,
}
"""Changes of an image, by name. Glare has a standard deviation of 2 to 20 px and 60 to 255 levels."""


def _far_light(image: U8, model: SensorModel, rng: Rng) -> U8:
    return nuisance.gain(image, float(rng.choice((0.3, 0.5, 0.7, 1.3, 1.5, 2.0, 3.0))))


def _far_moved(image: U8, model: SensorModel, rng: Rng) -> U8:
    rows, cols = (int(rng.choice((-1, 1)) * rng.integers(2, 6)) for _ in range(2))
    return nuisance.shift(image, rows, cols)


def _far_noisy(image: U8, model: SensorModel, rng: Rng) -> U8:
    return camera_faults.noise(image, float(rng.uniform(15, 50)), int(rng.integers(1 << 30)))


def _blurred(image: U8, model: SensorModel, rng: Rng) -> U8:
    return camera_faults.defocus(image, float(rng.uniform(1, 5)))


def _torn_row(model: SensorModel, rng: Rng) -> int:
    return round(model.row_c + model.disc_radius_px * float(rng.choice((-0.6, -0.3, 0.0, 0.3, 0.6))))


def _sideways(px: int) -> Change:
    def change(image: U8, model: SensorModel, rng: Rng) -> U8:
        scaled_px = round(px * model.image_width_px / 640)
        return camera_faults.torn(image, image, _torn_row(model, rng), scaled_px * int(rng.choice((-1, 1))))

    return change


def _repeated(image: U8, model: SensorModel, rng: Rng) -> U8:
    row = _torn_row(model, rng)
    spoiled = image.copy()
    spoiled[row:] = image[row]
    return spoiled


def _down(image: U8, model: SensorModel, rng: Rng) -> U8:
    row, px = _torn_row(model, rng), round(40 * model.image_height_px / 480)
    spoiled = image.copy()
    spoiled[row:] = image[row - px : len(image) - px]
    return spoiled


def _flat_below(image: U8, model: SensorModel, rng: Rng) -> U8:
    return camera_faults.torn(image, np.full_like(image, int(rng.choice((0, 128)))), _torn_row(model, rng))


TORN: dict[str, Change] = {
    "torn: rows sideways by 60 px": _sideways(60),
    "torn: rows sideways by 200 px": _sideways(200),
    "torn: one row again and again": _repeated,
    "torn: rows down by 40 px": _down,
    "torn: black or grey below": _flat_below,
}
"""Torn images; the tear begins at one of five rows, and pixels are those of a 640x480 image."""


BEYOND: dict[str, Change] = {
    "light x0.3 to x3": _far_light,
    "moved by 3 to 7 px": _far_moved,
    "noise of 15 to 50 levels": _far_noisy,
    "blur of 1 to 5 px": _blurred,
    **TORN,
}
"""Disturbances that are not compensated; at best, the result is invalid or degraded."""

WITHOUT_CONTACT = (*CHANGES, RELEASED)


def without_contact(sensor: PressedSensor, what: str, seed: int, noise_seed: int) -> U8:
    """Take an image without contact, disturbed by one of `WITHOUT_CONTACT` or `BEYOND`, as drawn from the seed."""
    rng = np.random.default_rng((seed, 31))
    if what == RELEASED:
        model = sensor.model
        rho, angle = model.skin_radius_mm * rng.uniform(0, 0.4), rng.uniform(0, 2 * math.pi)
        radius, depth, part = rng.uniform(3, 9), rng.uniform(2, 4), rng.uniform(*LEFT)
        press = Press(ball(radius), rho * math.cos(angle), rho * math.sin(angle), depth)
        return released(sensor, (press,), part, noise_seed).image
    return (CHANGES | BEYOND)[what](sensor.frame((), noise_seed).image, sensor.model, rng)
