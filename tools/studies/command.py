"""The options and output files that the studies' programs share."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from tacshade_edge.cli.shared import study
from tacshade_edge.core.calibration.presses.press_selection import MIN_PRESSES
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.errors import TacshadeError
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.studies.evaluate.sensors import PRESSES, REFERENCES, SensorName
from tools.testbed.simulator.families import FINAL_SEED, FINAL_SENSORS, working_sensors

NETWORKS = tuple(name for name in PROFILES if name != "paper")
"""The profiles that take far less than a second per frame."""


def options(what: str, sensors: str, final: tuple[SensorName, ...] = FINAL_SENSORS) -> argparse.ArgumentParser:
    """A parser for profiles, sensors, an output folder and a cluster.

    Parameters
    ----------
    what : str
        The study, for ``--help``.
    sensors : str
        The default sensors.
    final : tuple of SensorName
        The sensors that ``--final`` selects.
    """
    parser = argparse.ArgumentParser(description=what)
    parser.add_argument("--profile", nargs="+", choices=list(PROFILES), default=list(NETWORKS), metavar="NAME")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write the table, its rows as CSV, and plots")
    which = parser.add_mutually_exclusive_group()
    named = f"[FAMILY:]SEED below {FINAL_SEED} or default ({sensors})"
    which.add_argument(
        "--sensors", type=working_sensors, default=working_sensors(sensors), metavar="SEED,...", help=named
    )
    kept = "the sensors kept for the figures of a release: not to be looked at while working"
    which.add_argument("--final", dest="sensors", action="store_const", const=final, help=kept)
    study.add_cluster(parser)
    parser.set_defaults(json=False)
    return parser


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
    """Make the folder before minutes of work; report a user's mistake in one line with exit code 1."""
    try:
        study.make_folder(out)
        yield
    except TacshadeError as error:
        parser.exit(1, f"{parser.prog}: {error}\n")


def publish(
    args: argparse.Namespace,
    stem: str,
    table: str,
    rows: Mapping[str, str],
    draw: Callable[[], Mapping[str, bytes]] = dict,
) -> None:
    """Print the table; write the table, its rows and its plots.

    Parameters
    ----------
    rows : mapping
        Text of each CSV file by the part of its name after `stem`.
    draw : callable
        Returns the plots by file name; called only if plots are wanted and can be drawn.
    """
    study.publish(args, stem, table, rows)
    if study.will_draw(args, "the plots"):
        for name, content in draw().items():
            study.write(args.out / name, content)
