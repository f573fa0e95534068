"""``tacshade-edge tradeoff``: speed against accuracy of the profiles and of what differs from them, on this machine."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tacshade_edge.cli import study
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.devices.files import calibration_file
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator.objects import OBJECTS, PAPER_OBJECTS
from tacshade_edge.studies.evaluate.own_images import images_in
from tacshade_edge.studies.evaluate.sensors import FAMILIES, FINAL_SEED
from tacshade_edge.studies.parallel import usable_cores
from tacshade_edge.studies.tradeoff import budget, cases, picture, report
from tacshade_edge.studies.tradeoff.cases import SensorCases
from tacshade_edge.studies.tradeoff.grid import grid
from tacshade_edge.studies.tradeoff.summary import Point
from tacshade_edge.studies.tradeoff.work import tradeoff

SENSORS = "default,5"
BUSY = 1.1
"""From so many times the processor time on, the machine was not this command's alone."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--profile",
        nargs="+",
        choices=list(PROFILES),
        metavar="NAME",
        help=f"some of {', '.join(PROFILES)}, each with what differs from it (all)",
    )
    parser.add_argument(
        "--budget-ms",
        type=_milliseconds,
        metavar="MS",
        help="print the settings of the most accurate profile that takes no longer for 99 of 100 frames in contact",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="write tradeoff.md, tradeoff.csv, tradeoff.json, tradeoff.png"
    )
    parser.add_argument("--json", action="store_true", help="print tradeoff.json in place of the tables")
    simulated = parser.add_argument_group("simulated sensors")
    simulated.add_argument(
        "--sensors",
        type=study.sensors,
        metavar="SEED,...",
        help=f"[FAMILY:]SEED below {FINAL_SEED} or default ({SENSORS}); families: {', '.join(FAMILIES)}",
    )
    simulated.add_argument(
        "--objects",
        type=study.objects,
        metavar="NAME,...",
        help=f"of {', '.join(OBJECTS)} (the paper's five)",
    )
    study.add_own_images(parser)
    parser.set_defaults(usage_error=parser.error)


def run(args: argparse.Namespace) -> int:
    """Measure; print the tables and the settings, write the files."""
    study.check_own_images(args)
    mistakes: list[str] = []
    if args.images is None:
        study.make_folder(args.out)
        sensors = args.sensors or study.sensors(SENSORS)
        objects = args.objects or tuple(PAPER_OBJECTS)
        data: dict[str, Any] = {"sensors": [str(name) for name in sensors], "objects": list(objects)}
        images = cases.simulated(sensors, objects, usable_cores(), study.progress)
    else:
        given = [name for name in ("sensors", "objects") if getattr(args, name) is not None]
        if given:
            args.usage_error(f"--{given[0]} is for simulated sensors, not for your own images")
        images, data = _own(args, mistakes), {"calibration": str(args.calibration), "images": str(args.images)}
    drawn = args.out is not None and picture.can_draw()
    if args.out and not drawn:
        print(f"tacshade-edge: tradeoff.png will be missing: {picture.INSTALL}", file=sys.stderr)
    names = tuple(dict.fromkeys(args.profile or PROFILES))
    found, busy = tradeoff(grid(names), images, usable_cores(), study.progress)
    if busy > BUSY:
        words = f"the machine was busy: frames took {busy:.1f} times as long as the processor time that is told"
        print(f"tacshade-edge: {words}", file=sys.stderr)
    summary = json.dumps(report.document(found, data, busy), indent=1)
    print(summary if args.json else report.table(found))
    if args.out:
        study.write(args.out / "tradeoff.md", report.table(found).encode() + b"\n")
        study.write(args.out / "tradeoff.csv", report.csv_text(found).encode())
        study.write(args.out / "tradeoff.json", summary.encode() + b"\n")
    if drawn:
        study.write(args.out / "tradeoff.png", picture.draw(found, args.budget_ms))
    kept = args.budget_ms is None or _tell_settings(found, args.budget_ms, aside=args.json)
    return 0 if kept and not mistakes else 1


def _own(args: argparse.Namespace, mistakes: list[str]) -> tuple[SensorCases, ...]:
    calibration = calibration_file.load(args.calibration)
    paths = images_in(args.images)
    study.make_folder(args.out)

    def mistake(text: str) -> None:
        mistakes.append(text)
        study.mistake(text)

    found = cases.own(calibration, args.calibration.name, paths, study.progress, mistake)
    if not any(case.touched for case in found.cases):
        raise ConfigError(f"{args.images}: found no image of a contact that can be scored, expected one with its truth")
    return (found,)


def _tell_settings(found: Sequence[Point], budget_ms: float, *, aside: bool) -> bool:
    """Print the settings for a budget; where none keeps it, say so and return False."""
    block = budget.settings_block(found, budget_ms)
    if block is None:
        print(f"tacshade-edge: {budget.over_budget(found, budget_ms)}", file=sys.stderr)
        return False
    print(f"\n{block}", file=sys.stderr if aside else sys.stdout)
    return True


def _milliseconds(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0):
        raise ValueError(text)
    return value


_milliseconds.__name__ = "number above 0"  # argparse's messages show it
