"""How a simulated sensor at rest looks on the days of its life: those of a sound one differ too."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.calibration.ageing.appearance import Appearance, appearance
from tacshade_edge.calibration.ageing.wears import History
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.press import Press, ball
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model
from tacshade_edge.lab.studies.evaluate.work import REFERENCES, calibrated_sensor
from tacshade_edge.types import F32, U8, Calibration
from tools.testbed.simulator.wear import Wear, WornSensor

YEAR = 365
FIRST_DAY = 20_000
"""A day since 1970, a Thursday."""
# Assumed, since nobody has watched such a sensor for a year. A season's warmth dims LEDs and widens
# the gel; days differ by the room, and looks by how long the sensor has been on.
_SEASON_LIGHT, _DAY_LIGHT, _WARM_UP = 0.03, 0.01, 0.02
_SEASON_MM, _DAY_MM = 0.02, 0.006
_DAY_PX, _DAY_ZOOM = 0.2, 0.0005
_KEPT = 0.8  # of a day's difference on the next day
# On some days dust lies on the camera or something rests on the skin, for up to so many days.
_DIRT, _LOAD, _SPELL_DAYS = 0.02, 0.02, 6
_SICK_PART = 0.05  # of the days have no look, besides weekends
_WORK_DAYS = (0, 1, 4, 5, 6)  # of a week that begins on a Thursday
_STEPS_PER_MM = 50
_FRAMES = 10
_SIZE = (240, 320)


@dataclass(frozen=True, slots=True)
class Day:
    """What differs on a day from the day of the calibration, beside wear; lengths in px are of
    pictures of 320x240.
    """

    number: int
    light: float
    swollen_mm: float
    row_px: float
    col_px: float
    zoom: float
    dirty: bool
    loaded: bool


def calibrated_model(seed: int, presses: int) -> tuple[SensorModel, Calibration]:
    """A new sensor of the simulator's family and its calibration. Raises ConfigError."""
    model = random_model(seed, *_SIZE)
    sensor = WornSensor(model, Wear())
    return model, calibrated_sensor(sensor, seed, REFERENCES, presses).calibration


def days_of(seed: int, count: int) -> Iterator[Day]:
    """The days on which a sound sensor is looked at, of `count` ones."""
    rng = np.random.default_rng((seed, 41))
    season = rng.uniform(0, 2 * math.pi)
    drift = np.zeros(5)
    dirty_until = loaded_until = 0
    for k in range(count):
        spread = math.sqrt(1 - _KEPT**2)
        drift = _KEPT * drift + spread * rng.standard_normal(5)
        warmth = math.sin(2 * math.pi * k / YEAR + season) - math.sin(season)
        warm_up, dirt, load, sick = rng.random(4)
        spell = int(rng.integers(1, _SPELL_DAYS + 1))
        dirty_until = k + spell if dirt < _DIRT else dirty_until
        loaded_until = k + spell if load < _LOAD else loaded_until
        if k % 7 not in _WORK_DAYS or sick < _SICK_PART:
            continue
        yield Day(
            FIRST_DAY + k,
            (1 - _SEASON_LIGHT * warmth) * (1 + _DAY_LIGHT * drift[0]) * (1 - _WARM_UP * warm_up),
            _SEASON_MM * warmth + _DAY_MM * drift[1],
            _DAY_PX * drift[2],
            _DAY_PX * drift[3],
            1 + _DAY_ZOOM * drift[4],
            k < dirty_until,
            k < loaded_until,
        )


def history_of(
    model: SensorModel, calibration: Calibration, seed: int, days: Iterable[Day]
) -> History:
    """The history of a sound sensor over some days."""
    history = History.empty()
    for day in days:
        # Skin that has swollen is less sunk; steps of 20 µm are drawn once.
        sunk_mm = -round(day.swollen_mm * _STEPS_PER_MM) / _STEPS_PER_MM
        sensor = _averaged(model, Wear(leaked_mm=sunk_mm))
        look = appearance(calibration, [_picture(sensor, day, seed)])
        if look is not None:
            history = history.with_day(day.number, look)
    return history


def worn_look(model: SensorModel, calibration: Calibration, wear: Wear, seed: int) -> Appearance:
    """How a worn sensor looks beside its calibration's reference."""
    sensor = _averaged(model, replace(wear, seed=seed))
    look = appearance(calibration, [sensor.exposed(sensor.drawn(sensor.rest), seed)])
    assert look is not None
    return look


@functools.lru_cache(maxsize=32)
def _averaged(model: SensorModel, wear: Wear) -> WornSensor:
    """A sensor whose pictures have the noise of the mean of ten."""
    part = 1 / math.sqrt(_FRAMES)
    quiet = replace(
        model,
        read_noise_grey=part * model.read_noise_grey,
        shot_noise_grey=part * model.shot_noise_grey,
    )
    return WornSensor(quiet, wear)


def _picture(sensor: WornSensor, day: Day, seed: int) -> U8:
    """The mean picture of a sensor at rest on a day."""
    model = sensor.model
    rng = np.random.default_rng((seed, day.number, 42))
    rho, angle = rng.uniform(0, 0.5) * model.disc_radius_px, rng.uniform(0, 2 * math.pi)
    row, col = rho * math.sin(angle), rho * math.cos(angle)
    skin = sensor.rest
    if day.loaded:
        mm = model.geometry.mm_per_px
        skin = sensor.skin((Press(ball(4.0), mm * col, mm * row, 0.2),))
    turn = cv2.getRotationMatrix2D((model.col_c, model.row_c), 0, day.zoom)
    turn[:, 2] += (day.col_px, day.row_px)
    size = model.image_width_px, model.image_height_px
    moved: F32 = np.asarray(
        cv2.warpAffine(
            sensor.drawn(skin),
            turn,
            size,
            flags=cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REPLICATE,
        ),
        np.float32,
    )
    image = sensor.exposed(np.maximum(moved, 0) * np.float32(day.light), seed + 7 * day.number)
    if day.dirty:
        image = camera_faults.speck(image, model.row_c + row, model.col_c + col, 4.0)
    return image
