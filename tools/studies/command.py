"""What the studies share: options, the way from sensors to rows, and output files."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.calibration.indenters import Indenter
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.presses.press_selection import MIN_PRESSES
from tacshade_edge.cli.shared import study
from tacshade_edge.cli.shared.options import add_cluster
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.errors import TacshadeError
from tacshade_edge.lab.parallel import Report, Workers, reported_map, workers
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.studies.evaluate.work import (
    PRESSES,
    REFERENCES,
    SensorName,
    calibrate_sensors,
)
from tacshade_edge.lab.studies.markdown import csv_text
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import U8, Calibration
from tools.testbed.simulator.families import FINAL_SEED, FINAL_SENSORS, working_sensors

NETWORKS = tuple(name for name, profile in PROFILES.items() if profile.network)
"""The profiles of which shear, sigma or a fit can be studied."""
COLOURS = ("#3d6fb4", "#e4572e", "#4a9c5d", "#8a5fb0")
ALONE = "_none"
"""Ends the name of a calibration that was fitted to references alone."""
Row = TypeVar("Row")
Part = TypeVar("Part")


class _Fitted(argparse.Action):
    """Takes the sensors whose fitted calibrations a folder contains."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option: str | None = None,
    ) -> None:
        namespace.fitted = {
            SensorName.parse(path.stem.removesuffix(ALONE).replace("_", ":")): path
            for path in sorted(Path(values).glob(f"*{ALONE}.npz"))
        }
        namespace.sensors = tuple(namespace.fitted)
        if not namespace.sensors:
            parser.error(f"--fitted: found no *{ALONE}.npz in {values}")


def options(
    what: str, sensors: str, final: tuple[SensorName, ...] = FINAL_SENSORS
) -> argparse.ArgumentParser:
    """A parser for profiles, sensors, and an output folder, with default and final sensors."""
    parser = argparse.ArgumentParser(description=what)
    parser.add_argument(
        "--profile", nargs="+", choices=list(PROFILES), default=list(NETWORKS), metavar="NAME"
    )
    which = parser.add_mutually_exclusive_group()
    named = f"[FAMILY:]SEED below {FINAL_SEED} or default ({sensors})"
    which.add_argument(
        "--sensors",
        type=working_sensors,
        default=working_sensors(sensors),
        metavar="SEED,...",
        help=named,
    )
    kept = "the sensors kept for the figures of a release: not to be looked at while working"
    which.add_argument("--final", dest="sensors", action="store_const", const=final, help=kept)
    which.add_argument(
        "--fitted",
        action=_Fitted,
        metavar="FOLDER",
        help="those that tools.studies.fit fitted to references",
    )
    add_output(parser)
    return parser


def add_output(parser: argparse.ArgumentParser) -> None:
    """Add the options that `run` and `publish` need."""
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="write the table, its rows as CSV, and plots"
    )
    add_cluster(parser)
    parser.set_defaults(json=False)


def add_calibration(parser: argparse.ArgumentParser) -> None:
    """Add options for the objects and each sensor's calibration."""
    parser.add_argument("--objects", type=study.objects, default=tuple(OBJECTS), metavar="NAME,...")
    parser.add_argument("--references", type=int, default=REFERENCES, metavar="N")
    parser.add_argument("--presses", type=int, default=PRESSES, metavar="N", help="0: none")


def check_presses(parser: argparse.ArgumentParser, presses: int) -> None:
    """Refuse fewer presses than a calibration needs."""
    if 0 < presses < MIN_PRESSES:
        parser.error(f"--presses: found {presses}, expected 0 or at least {MIN_PRESSES}")


@contextlib.contextmanager
def folder_for(parser: argparse.ArgumentParser, out: Path | None) -> Iterator[None]:
    """Make the folder before minutes of work; report a user's mistake in one line
    with exit code 1.
    """
    try:
        study.make_folder(out)
        yield
    except TacshadeError as error:
        parser.exit(1, f"{parser.prog}: {error}\n")


def calibrations(
    fitted: Mapping[SensorName, Path] | None,
    sensors: Sequence[SensorName],
    references: int,
    presses: int,
    pool: Workers,
    report: Report,
) -> list[Calibration]:
    """Calibrate the sensors, or load their fitted calibrations.

    Raises ConfigError (a sensor cannot be calibrated) and DeviceError (a worker was killed).
    """
    if fitted is None:
        return [
            made.calibration
            for made in calibrate_sensors(sensors, references, presses, pool, report)
        ]
    return [calibration_file.load(fitted[name]) for name in sensors]


def over_sensors(
    job: Callable[[tuple[SensorName, Calibration, Part]], Sequence[Row]],
    sensors: Sequence[SensorName],
    parts: Sequence[Part],
    pool: Workers,
    report: Report,
    *,
    references: int = REFERENCES,
    presses: int = PRESSES,
    fitted: Mapping[SensorName, Path] | None = None,
) -> list[Row]:
    """Calibrate the sensors, and do a job for each part (the longest first) on each of them;
    return the rows.

    Raises ConfigError (a sensor cannot be calibrated) and DeviceError (a worker was killed).
    """
    found = calibrations(fitted, sensors, references, presses, pool, report)
    tasks = [
        (name, made, part) for part in parts for name, made in zip(sensors, found, strict=True)
    ]
    return [
        row for rows in reported_map(job, tasks, pool, report, "parts of the study") for row in rows
    ]


def run(
    parser: argparse.ArgumentParser,
    args: argparse.Namespace,
    stem: str,
    work: Callable[[Workers, Report], Sequence[Row]],
    text: Callable[[Sequence[Row]], str],
    kinds: Mapping[str, type[Any]],
) -> None:
    """Work; print the table, and write it and its rows;
    `kinds` are those of rows by the end of their file's name.
    """
    with folder_for(parser, args.out), workers(args.cluster) as pool:
        rows = work(pool, Progress())
        files = {
            end: csv_text(kind, [row for row in rows if isinstance(row, kind)])
            for end, kind in kinds.items()
        }
        study.publish(args, stem, text(rows), files)


PLACE_NOISE_MM, DEPTH_NOISE_MM = 0.05, 0.03
"""Standard deviations of a stated place, along x and y, and of a stated depth."""


def stated_press(
    rng: np.random.Generator,
    name: str,
    image: U8,
    press: Press,
    radius_mm: float,
    known: Indenter | None,
) -> KnownPress:
    """State a press of a ball of `radius_mm`, or of another indenter that is `known`."""
    x_mm, y_mm = (at + rng.normal(0, PLACE_NOISE_MM) for at in (press.x_mm, press.y_mm))
    depth_mm = press.depth_mm + rng.normal(0, DEPTH_NOISE_MM)
    return KnownPress(
        name, image, radius_mm, depth_mm, x_mm, y_mm, known, press.rotation_deg if known else 0.0
    )
