#!/usr/bin/env python3
"""How small an image may be: every sensor's pictures at several sizes, each calibrated on its own.

::

    .venv/bin/python -m tools.studies.image_size [--sensors default,5 | --final]
        [--profile balanced]

The pictures of a 640x480 camera are averaged to smaller ones, as a camera that bins its pixels
does, so all sizes see the same presses. A row is a size; its pitches are those that `calibrate`
measured in the middle of the pictures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from tacshade_edge.calibration.calibrate import CalibrationResult
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.parallel import Report, Workers, reported_map
from tacshade_edge.lab.simulator.press import PAPER_OBJECTS, Press
from tacshade_edge.lab.simulator.truth import SimulatedFrame
from tacshade_edge.lab.studies.evaluate.score import score
from tacshade_edge.lab.studies.evaluate.work import (
    PRESSES,
    REFERENCES,
    PressedSensor,
    SensorName,
    calibrated_sensor,
    press_cases,
    reconstructor,
    scenes,
)
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.types import U8, Frame
from tools.studies import command

SENSORS = "default,5,11,21,22,23,other:default,other:31"
WIDTHS_PX = (640, 480, 320, 240, 160)
WHOLE_PX = WIDTHS_PX[0]
SCENES_STEP = 4
"""One scene of so many: each place and each depth once."""


@dataclass(frozen=True, slots=True)
class Row:
    """How a profile fares with the pictures of a sensor at a size;
    NaN where `calibrate` refuses them.
    """

    width_px: int
    profile: str
    sensor: str
    pitch_px: float
    me_mm: float  # eq. 13; a missed contact counts with its true depth
    missed: int
    frames: int
    left_out: int  # right presses that `calibrate` left out
    refusal: str


class Remembered:
    """A sensor that takes each picture once; its pictures differ in their noise seeds."""

    def __init__(self, sensor: PressedSensor) -> None:
        self.model = sensor.model
        self._sensor = sensor
        self._taken: dict[int, SimulatedFrame] = {}

    def frame(self, presses: Sequence[Press] = (), noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture, or return the one taken before."""
        if noise_seed not in self._taken:
            self._taken[noise_seed] = self._sensor.frame(presses, noise_seed)
        return self._taken[noise_seed]


class Smaller:
    """A sensor whose camera averages its pixels."""

    def __init__(self, sensor: PressedSensor, width_px: int) -> None:
        self.model = sensor.model
        self._sensor = sensor
        self._width_px = width_px

    def frame(self, presses: Sequence[Press] = (), noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture."""
        frame = self._sensor.frame(presses, noise_seed)
        return replace(frame, image=smaller(frame.image, self._width_px))


def smaller(image: U8, width_px: int) -> U8:
    """Average a picture to another width."""
    height_px = image.shape[0] * width_px // image.shape[1]
    return np.asarray(
        cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA), np.uint8
    )


def rows_of(profiles: Sequence[str], name: SensorName) -> list[Row]:
    """Calibrate a sensor on its pictures of each size and press the paper's objects."""
    sensor = Remembered(name.make())
    return [row for width_px in WIDTHS_PX for row in _rows(profiles, name, sensor, width_px)]


def _rows(
    profiles: Sequence[str], name: SensorName, sensor: PressedSensor, width_px: int
) -> list[Row]:
    try:
        made = calibrated_sensor(Smaller(sensor, width_px), name.seed or 0, REFERENCES, PRESSES)
    except ConfigError as error:
        return [
            Row(width_px, each, str(name), math.nan, math.nan, 0, 0, 0, refusal=str(error))
            for each in profiles
        ]
    pitch_px, left_out = made.calibration.pitch_px, PRESSES - len(made.presses)
    rows = []
    for profile in profiles:
        errors_mm, missed = _judged(profile, name, sensor, made, width_px)
        me_mm = float(np.mean(errors_mm))
        rows.append(
            Row(width_px, profile, str(name), pitch_px, me_mm, missed, len(errors_mm), left_out, "")
        )
    return rows


def _judged(
    profile: str, name: SensorName, sensor: PressedSensor, made: CalibrationResult, width_px: int
) -> tuple[list[float], int]:
    """The error of a profile in mm for each press of the paper's objects,
    and how many presses it missed.
    """
    one = reconstructor(made.calibration, profile)
    errors_mm, missed = [], 0
    for object_name in PAPER_OBJECTS:
        some = scenes(sensor.model, name.seed, object_name)[::SCENES_STEP]
        for case in press_cases(name, sensor, some):
            result = one.step(Frame(0, 0, 0, smaller(case.image, width_px)))
            me_mm = score(case.label, case.truth, result).me_mm
            missed += math.isnan(me_mm)
            errors_mm.append(case.truth.depth_max_mm if math.isnan(me_mm) else me_mm)
    return errors_mm, missed


def table(rows: Sequence[Row]) -> str:
    """One line for each size and profile, over the sensors
    that `calibrate` takes at every size down to it.
    """
    lines = []
    for width_px in WIDTHS_PX:
        for profile in dict.fromkeys(row.profile for row in rows):
            some = [row for row in rows if (row.width_px, row.profile) == (width_px, profile)]
            taken = [row for row in some if not row.refusal]
            whole = {
                r.sensor: r.me_mm for r in rows if (r.width_px, r.profile) == (WHOLE_PX, profile)
            }
            ratios = [row.me_mm / whole[row.sensor] for row in taken]
            lines.append(
                (
                    f"{width_px}x{width_px * 3 // 4}",
                    profile,
                    f"{len(taken)} of {len(some)}",
                    (
                        f"{min(row.pitch_px for row in taken):.1f} to "
                        f"{max(row.pitch_px for row in taken):.1f}"
                    ),
                    f"{np.mean([row.me_mm for row in taken]):.3f}",
                    f"{np.nanmean(ratios):.2f}",
                    f"{np.nanmax(ratios):.2f}",
                    f"{sum(row.missed for row in taken)} of {sum(row.frames for row in taken)}",
                    f"{np.mean([row.left_out for row in taken]):.1f}",
                )
            )
    header = (
        "image",
        "profile",
        "calibrated",
        "pitch px",
        "ME mm",
        "beside 640x480",
        "worst sensor",
        "missed",
        "presses left out",
    )
    return markdown(header, lines)


def work(
    sensors: Sequence[SensorName], profiles: Sequence[str], pool: Workers, report: Report
) -> list[Row]:
    """All rows, sensor by sensor."""
    job = partial(rows_of, tuple(profiles))
    made = reported_map(job, sensors, pool, report, "sensors studied")
    return [row for rows in made for row in rows]


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = command.options("How small an image may be.", SENSORS)
    args = parser.parse_args(words)
    made = partial(work, args.sensors, args.profile)
    command.run(parser, args, "image_size", made, table, {"": Row})


if __name__ == "__main__":
    main()
