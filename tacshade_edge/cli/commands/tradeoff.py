"""``tacshade-edge tradeoff``: measures speed against accuracy of the profiles and their variants on this machine."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any

from tacshade_edge.cli.shared import study
from tacshade_edge.cli.shared.options import POSITIVE, add_option, warn
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.doctor.board import board_facts, heat
from tacshade_edge.doctor.machine import Machine
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator.press import PAPER_OBJECTS
from tacshade_edge.studies.parallel import workers
from tacshade_edge.studies.tradeoff import report
from tacshade_edge.studies.tradeoff.measure import (
    Point,
    SensorCases,
    Setting,
    grid,
    score_settings,
    simulated,
    weigh_and_time,
)

SENSORS = "default,5"
BUSY = 1.1
"""Ratio of wall time to processor time above which other programs kept the machine busy."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    files = "tradeoff.md, tradeoff.csv, tradeoff.json and tradeoff.png"
    study.add_arguments(parser, "default: every profile and variants of each", files)
    text = "print the settings of the most accurate profile that needs at most MS ms for 99 of 100 frames in contact"
    add_option(parser, "--budget-ms", "MS", text, POSITIVE)
    text = "time only the shipped profiles and print a report to send in; it omits this board's host name"
    parser.add_argument("--report", action="store_true", help=text)
    study.add_simulated(parser, SENSORS, "the paper's five")


def run(args: argparse.Namespace) -> int:
    """Measure, print the tables and the settings, and write the files."""
    if args.report:
        return _report(args)
    mistakes: list[str] = []
    names = tuple(dict.fromkeys(args.profile or PROFILES))
    settings = grid(names)
    own = study.is_own(args, ("sensors", "objects"))
    study.make_folder(args.out)
    with workers() as pool:
        if own:
            calibration, cases, mistakes = study.own_images(args)
            images: tuple[SensorCases, ...] = (SensorCases(calibration, tuple(cases)),)
            if not any(case.touched for case in images[0].cases):
                expected = "found no image of a contact to score, expected at least one with a truth file"
                raise ConfigError(f"{args.images}: {expected}")
            data: dict[str, Any] = {"calibration": str(args.calibration), "images": str(args.images)}
        else:
            sensors = args.sensors or study.sensors(SENSORS)
            objects = args.objects or tuple(PAPER_OBJECTS)
            data = {"sensors": [str(name) for name in sensors], "objects": list(objects)}
            images = simulated(sensors, objects, pool, Progress())
        drawn = study.will_draw(args, "tradeoff.png")
        rows = score_settings(settings, images, pool, Progress())
    found, busy = weigh_and_time(settings, images, rows, Progress())
    if busy > BUSY:
        warn(f"the machine was busy: frames took {busy:.1f} times as long as the processor time shown here")
    document = report.document(found, data, busy)
    study.publish(args, "tradeoff", report.table(found), {"": report.csv_text(found)}, document)
    if drawn:
        study.write(args.out / "tradeoff.png", report.draw(found, args.budget_ms))
    kept = args.budget_ms is None or _print_settings(found, args.budget_ms, aside=args.json)
    return 0 if kept and not mistakes else 1


def _report(args: argparse.Namespace) -> int:
    """Measure the shipped profiles in the same way on every board, and print a report."""
    for name in ("profile", "out", "calibration", "images", "budget_ms", "sensors", "objects"):
        if getattr(args, name) is not None:
            args.parser.error(f"--report measures the same on every board: expected no --{name.replace('_', '-')}")
    if args.json:
        args.parser.error("--report prints Markdown: expected no --json")
    machine, progress = Machine(), Progress()
    facts, before = board_facts(machine), heat(machine)
    settings = [Setting(PROFILES[name]) for name in report.PROFILES]
    with workers() as pool:
        images = simulated(study.sensors("default"), tuple(PAPER_OBJECTS), pool, progress)
        rows = score_settings(settings, images, pool, progress)
    found, busy = weigh_and_time(settings, images, rows, progress)
    if before:
        facts |= {"before": before, "after": heat(machine)}
    print(report.board_block(facts, found, busy), end="")
    return 0


def _print_settings(found: Sequence[Point], budget_ms: float, *, aside: bool) -> bool:
    """Print the settings for a budget; if no profile keeps it, print that and return False."""
    block = report.settings_block(found, budget_ms)
    if block is None:
        warn(report.over_budget(found, budget_ms))
        return False
    print(f"\n{block}", file=sys.stderr if aside else sys.stdout)
    return True
