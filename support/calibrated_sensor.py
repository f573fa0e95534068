"""Simulated sensors and their calibrations, made once per test session."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from support.shared import once_for_all_workers
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.files.calibration_file import with_crc
from tacshade_edge.calibration.inputs import KnownPress, StatedSensor
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball
from tacshade_edge.lab.simulator.script import ball_presses
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model, tactip
from tacshade_edge.lab.simulator.truth import SimulatedFrame, SimulatedSensor
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.sensor.inference.network import load_networks, make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Calibration, Frame, Reconstruction

if TYPE_CHECKING:
    from tacshade_edge.lab.fitting.prints import Found

FULL = SensorModel()
# The same sensor through a camera of half the resolution.
HALF = replace(
    FULL, image_height_px=240, image_width_px=320, row_c=118.2, col_c=163.8, disc_radius_px=102.5
)
TACTIP = tactip(HALF)
EVERY_PROFILE = list(PROFILES)


def sensor_of(model: SensorModel) -> StatedSensor:
    """The settings that a person would state for a simulated sensor."""
    known = model.geometry
    return StatedSensor(
        skin_radius_mm=known.skin_radius_mm,
        camera_distance_mm=known.camera_distance_mm,
        visible_half_angle_deg=known.visible_half_angle_deg,
        polarity="dark" if model.pin_tip_reflectance > 0.5 else "bright",
        pad_radius_mm=known.pad_radius_mm,
    )


@cache
def simulated(model: SensorModel = HALF) -> SimulatedSensor:
    return SimulatedSensor(model)


@cache
def random_sensor(seed: int) -> SensorModel:
    return random_model(seed)


@cache
def references(model: SensorModel = HALF, count: int = 5) -> tuple[U8, ...]:
    return tuple(simulated(model).frame((), seed).image for seed in range(count))


@cache
def presses(model: SensorModel = HALF, count: int = 20) -> tuple[KnownPress, ...]:
    return tuple(
        KnownPress(
            f"press {k}",
            simulated(model).frame((press,), 100 + k).image,
            radius_mm,
            press.depth_mm,
            press.x_mm,
            press.y_mm,
        )
        for k, (press, radius_mm) in enumerate(ball_presses(model, count))
    )


@cache
def calibrated(model: SensorModel = HALF, count: int = 20) -> Calibration:
    """A calibration from 5 references and `count` ball presses; 0: references alone."""

    def made() -> Calibration:
        table = presses(model, count) if count else ()
        return with_crc(
            calibrate(
                sensor_of(model), references(model), table, networks=load_networks()
            ).calibration
        )

    return once_for_all_workers(f"calibrated {model!r} {count}", made)


PIN_LENGTH_MM = 3.04


@cache
def found_prints() -> list[Found]:
    """The prints that `calibrate --fit` finds in `HALF`'s reference,
    their pins' length stated (ten seconds).
    """
    from tacshade_edge.lab.fitting.identify import identify

    stated = {"pin_length_mm": PIN_LENGTH_MM}
    return once_for_all_workers("found prints", lambda: identify(calibrated(), stated))


@cache
def reconstructor(profile: str, model: SensorModel = HALF, count: int = 20) -> Reconstructor:
    return make_reconstructor(calibrated(model, count), PROFILES[profile])


@cache
def pressed(
    name: str, depth_mm: float, model: SensorModel = HALF, x_mm: float = 0.0, y_mm: float = 0.0
) -> SimulatedFrame:
    """A frame that no calibration saw."""
    return simulated(model).frame((Press(OBJECTS[name](), x_mm, y_mm, depth_mm),), 7)


def loaded(depth_mm: float, x_mm: float, model: SensorModel = HALF) -> list[U8]:
    """Three frames of the skin under a ball, mm on the nominal skin."""
    scale = skin_scale(model.geometry)
    press = Press(ball(6.0 * scale), x_mm * scale, 0.0, depth_mm * scale)
    return [simulated(model).frame((press,), seed).image for seed in range(3)]


def unloaded(model: SensorModel = HALF, noise_seed: int = 50) -> U8:
    """A frame without contact that is not one of the references."""
    return simulated(model).frame((), noise_seed).image


def step(profile: str, image: U8, model: SensorModel = HALF, count: int = 20) -> Reconstruction:
    return reconstructor(profile, model, count).step(Frame(0, 0, 0, np.array(image)))
