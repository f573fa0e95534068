"""``tacshade-edge evaluate``: runs the paper's Experiment 1 on simulated sensors, or scores a user's own images."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tacshade_edge.cli.commands import evaluate_labels
from tacshade_edge.cli.shared import study
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.core.calibration.presses.press_selection import MIN_PRESSES
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator.objects import OBJECTS, PAPER_OBJECTS
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.studies.evaluate import picture, report
from tacshade_edge.studies.evaluate.labelled import COLUMNS
from tacshade_edge.studies.evaluate.own_images import evaluate_images
from tacshade_edge.studies.evaluate.report import figures
from tacshade_edge.studies.evaluate.score import Row
from tacshade_edge.studies.evaluate.sensors import PRESSES, REFERENCES
from tacshade_edge.studies.evaluate.work import Evaluation, Plan, Timing, evaluate, time_profiles
from tacshade_edge.studies.parallel import workers
from tacshade_edge.studies.tables import csv_text

WORKING_SENSORS = "default,5,11,21"
SIMULATED = ("sensors", "objects", "presses", "references", "cluster")
"""Options that are only for simulated sensors."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    study.add_arguments(
        parser,
        profiles="default: all but paper, which takes a second per frame",
        files="evaluation.md, evaluation.csv, evaluation.json and figure6.png",
    )
    labelled = parser.add_argument_group("your own frames with labels instead of surfaces (--images, --labels)")
    labelled.add_argument(
        "--labels",
        type=Path,
        metavar="CSV",
        help=f"table with an image column and any of the columns {', '.join(COLUMNS)}",
    )
    labelled.add_argument(
        "--sensor",
        type=Path,
        metavar="SENSOR.yaml",
        help="file that describes the sensor's dimensions and camera, instead of --calibration",
    )
    labelled.add_argument(
        "--reference",
        type=Path,
        nargs="+",
        metavar="IMG",
        help="with --sensor: images of the untouched skin (default: the least loaded frame)",
    )
    study.add_cluster(parser)
    simulated = study.add_simulated(parser, WORKING_SENSORS, "all")
    simulated.add_argument(
        "--presses",
        type=_count,
        metavar="N",
        help="number of ball presses in each calibration; 0 is allowed (default: 40)",
    )
    simulated.add_argument(
        "--references", type=_count, metavar="N", help="number of reference images in each calibration (default: 8)"
    )


def run(args: argparse.Namespace) -> int:
    """Evaluate, print the tables and write the files."""
    if args.labels is not None or args.sensor is not None or args.reference is not None:
        return evaluate_labels.run(_labels_checked(args), _profiles(args))
    return _own(args) if study.is_own(args, SIMULATED) else _simulated(args)


def _labels_checked(args: argparse.Namespace) -> argparse.Namespace:
    """Return the arguments; exit with a usage error if any cannot be combined with labels."""
    given = [name for name in SIMULATED if getattr(args, name) is not None]
    if given:
        args.usage_error(f"--{given[0]} cannot be used with --labels")
    if args.images is None or args.labels is None:
        args.usage_error("--images DIR and --labels CSV must be given together")
    if (args.calibration is None) == (args.sensor is None):
        args.usage_error("--labels needs one of --calibration CAL.npz and --sensor SENSOR.yaml")
    if args.reference is not None and args.sensor is None:
        args.usage_error("--reference requires --sensor")
    return args


def _profiles(args: argparse.Namespace) -> tuple[str, ...]:
    return tuple(dict.fromkeys(args.profile or (name for name in PROFILES if name != "paper")))


def _simulated(args: argparse.Namespace) -> int:
    presses = _presses(args)
    if args.references == 0:
        args.usage_error("--references: found 0, expected at least 1")
    plan = Plan(
        sensors=args.sensors or study.sensors(WORKING_SENSORS),
        profiles=_profiles(args),
        objects=args.objects or tuple(OBJECTS),
        references=args.references or REFERENCES,
        presses=presses,
    )
    study.make_folder(args.out)
    drawn = study.will_draw(args, "figure6.png", picture.PACKAGES)
    with workers(args.cluster) as pool:
        found = evaluate(plan, pool, Progress())
    timings = time_profiles(plan, found.calibrations[0].calibration, Progress())
    _publish(args, found.rows, timings, _settings(plan, found))
    if drawn:
        profile = _best(found.rows)
        names = [name for name in plan.objects if name in PAPER_OBJECTS] or plan.objects
        calibration = found.calibrations[0].calibration
        shown = picture.columns(plan.sensors[0], calibration, profile, names)
        study.write(args.out / "figure6.png", picture.draw(shown, calibration, profile))
    return 0


def _presses(args: argparse.Namespace) -> int:
    presses = PRESSES if args.presses is None else int(args.presses)
    if 0 < presses < MIN_PRESSES:
        args.usage_error(f"--presses: found {presses}, expected 0 or at least {MIN_PRESSES}")
    return presses


def _own(args: argparse.Namespace) -> int:
    calibration, cases, mistakes = study.own_images(args)
    rows, timings = evaluate_images(calibration, _profiles(args), cases)
    if not rows:
        raise ConfigError(f"{args.images}: found no image to score, expected at least one image with a truth file")
    settings = {"calibration": str(args.calibration), "crc32": f"{calibration.crc32:08x}", "images": str(args.images)}
    _publish(args, rows, timings, settings)
    return 1 if mistakes else 0


def _settings(plan: Plan, found: Evaluation) -> dict[str, Any]:
    """The plan, with the model and calibration fit of each sensor."""
    sensors = [
        {
            "name": str(name),
            "model": asdict(name.make().model),
            "fit": calibration_file.fit_figures(made.calibration.fit),
            "warnings": list(made.warnings),
        }
        for name, made in zip(plan.sensors, found.calibrations, strict=True)
    ]
    return {**asdict(plan), "sensors": sensors}


def _best(rows: Sequence[Row]) -> str:
    """The profile with the smallest mean ME."""
    profiles = list(dict.fromkeys(r.profile for r in rows))
    return min(profiles, key=lambda p: figures(r for r in rows if r.profile == p).me_mm)


def _publish(
    args: argparse.Namespace, rows: Sequence[Row], timings: Mapping[str, Timing], settings: Mapping[str, Any]
) -> None:
    document = report.document(rows, timings, settings)
    study.publish(args, "evaluation", report.table(rows, timings), {"": csv_text(Row, rows)}, document)


def _count(text: str) -> int:
    value = int(text)
    if not 0 <= value < 10_000:
        raise ValueError(text)
    return value


_count.__name__ = "whole number"  # argparse's messages show it
