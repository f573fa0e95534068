"""``tacshade-edge evaluate``: Experiment 1 of the paper on simulated sensors, or a user's own images with truth."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tacshade_edge.cli import evaluate_labels, study
from tacshade_edge.cli.progress import Progress
from tacshade_edge.core.calibration.press_selection import MIN_PRESSES
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.devices.files import calibration_file
from tacshade_edge.devices.files.labels import COLUMNS
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator.objects import OBJECTS, PAPER_OBJECTS
from tacshade_edge.studies.ablation.work import AblationRow, ablate, object_rows
from tacshade_edge.studies.ablation.work import Plan as AblationPlan
from tacshade_edge.studies.ablation.work import text as ablation_text
from tacshade_edge.studies.drag.picture import draw as draw_drag
from tacshade_edge.studies.drag.summary import text as drag_text
from tacshade_edge.studies.drag.work import DragRow
from tacshade_edge.studies.drag.work import Plan as DragPlan
from tacshade_edge.studies.drag.work import study as drag
from tacshade_edge.studies.evaluate import picture, report
from tacshade_edge.studies.evaluate.own_images import evaluate_images
from tacshade_edge.studies.evaluate.score import Row
from tacshade_edge.studies.evaluate.sensors import FINAL_SEED, PRESSES, REFERENCES, SensorName
from tacshade_edge.studies.evaluate.summary import figures
from tacshade_edge.studies.evaluate.work import Evaluation, Plan, Timing, evaluate, time_profiles
from tacshade_edge.studies.limits import picture as limits_picture
from tacshade_edge.studies.limits.summary import text as limits_text
from tacshade_edge.studies.limits.work import Plan as LimitsPlan
from tacshade_edge.studies.limits.work import limits
from tacshade_edge.studies.parallel import usable_cores
from tacshade_edge.studies.sigma.picture import draw as draw_sigma
from tacshade_edge.studies.sigma.summary import text as sigma_text
from tacshade_edge.studies.sigma.work import Plan as SigmaPlan
from tacshade_edge.studies.sigma.work import SigmaRow
from tacshade_edge.studies.sigma.work import study as sigma
from tacshade_edge.studies.slip.summary import text as slip_text
from tacshade_edge.studies.slip.work import HeldRow, ReleaseRow, SlideRow
from tacshade_edge.studies.slip.work import Plan as SlipPlan
from tacshade_edge.studies.slip.work import study as slip
from tacshade_edge.studies.tables import csv_text

WORKING_SENSORS = "default,5,11,21"
FINAL_SENSORS = tuple(SensorName(family, FINAL_SEED + k) for family in ("tacshade", "other") for k in (18, 19, 20))
FINAL_DRAGGED = tuple(FINAL_SENSORS[k] for k in (0, 1, 3, 4))  # a dragged frame takes a second
LIMITS_SENSORS = "default,5,11"
DRAG_SENSORS = "default,5,other:31,other:32"
ABLATION_SENSORS = "default,5,11,other:31,other:32,other:33"
SIMULATED = ("sensors", "final", "objects", "presses", "references")
"""Options that mean nothing to a user's own images."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    study.add_arguments(
        parser,
        profiles="all but paper, which takes a second for each frame",
        files="evaluation.md, evaluation.csv, evaluation.json, figure6.png",
    )
    labelled = parser.add_argument_group("your own frames with labels, in place of surfaces (--images, --labels)")
    labelled.add_argument("--labels", type=Path, metavar="CSV", help=f"image,{','.join(COLUMNS)}; any may be empty")
    labelled.add_argument(
        "--sensor", type=Path, metavar="SENSOR.yaml", help="what is known of the sensor, in place of --calibration"
    )
    labelled.add_argument(
        "--reference", type=Path, nargs="+", metavar="IMG", help="with --sensor: unloaded (the least loaded frame)"
    )
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument(
        "--ablation",
        action="store_true",
        help=f"where the error comes from instead: one profile with parts of it made perfect ({ABLATION_SENSORS})",
    )
    instead.add_argument(
        "--limits",
        action="store_true",
        help=f"where it ends instead: phantoms, least and greatest depth, finest shape ({LIMITS_SENSORS})",
    )
    instead.add_argument(
        "--drag",
        action="store_true",
        help=f"objects that are dragged, twisted and tilted instead ({DRAG_SENSORS})",
    )
    instead.add_argument(
        "--slip",
        action="store_true",
        help=f"slips and releases instead: told how soon, and falsely ({LIMITS_SENSORS})",
    )
    instead.add_argument(
        "--sigma",
        action="store_true",
        help=f"whether the standard deviation of each height holds instead ({DRAG_SENSORS})",
    )
    simulated, which = study.add_simulated(parser, WORKING_SENSORS, "all")
    which.add_argument(
        "--final",
        action="store_true",
        default=None,
        help=f"sensors from seed {FINAL_SEED} on, for the figures of a release: not to be looked at while working",
    )
    simulated.add_argument("--presses", type=_count, metavar="N", help="ball presses in each calibration; 0: none (40)")
    simulated.add_argument("--references", type=_count, metavar="N", help="reference images in each calibration (8)")


def run(args: argparse.Namespace) -> int:
    """Evaluate; print the tables, write the files."""
    if args.labels is not None or args.sensor is not None or args.reference is not None:
        return evaluate_labels.run(_labels_checked(args), _profiles(args))
    if args.limits:
        return _limits(args)
    if args.ablation:
        return _ablation(args)
    if args.drag:
        return _drag(args)
    if args.slip:
        return _slip(args)
    if args.sigma:
        return _sigma(args)
    return _own(args) if study.is_own(args, SIMULATED) else _simulated(args)


def _labels_checked(args: argparse.Namespace) -> argparse.Namespace:
    """Refuse what does not go with labels."""
    given = [name for name in SIMULATED if getattr(args, name) is not None]
    given += [name for name in ("ablation", "limits", "drag", "slip", "sigma") if getattr(args, name)]
    if given:
        args.usage_error(f"--{given[0]} does not go with --labels")
    if args.images is None or args.labels is None:
        args.usage_error("--images DIR and --labels CSV belong together")
    if (args.calibration is None) == (args.sensor is None):
        args.usage_error("--labels needs one of --calibration CAL.npz and --sensor SENSOR.yaml")
    if args.reference is not None and args.sensor is None:
        args.usage_error("--reference goes with --sensor")
    return args


def _alone(args: argparse.Namespace, option: str) -> None:
    """Refuse what a study of its own would not heed."""
    others = ("images", "calibration", "objects", "presses", "references")
    unfit = [name for name in others if getattr(args, name) is not None]
    if unfit or args.json:
        args.usage_error(f"--{unfit[0] if unfit else 'json'} does not go with --{option}")


def _profiles(args: argparse.Namespace) -> tuple[str, ...]:
    return tuple(dict.fromkeys(args.profile or (name for name in PROFILES if name != "paper")))


def _ablation(args: argparse.Namespace) -> int:
    _alone(args, "ablation")
    profile, *more = dict.fromkeys(args.profile or ["accurate"])
    if more or PROFILES[profile].network is None:
        args.usage_error(f"--profile: found {' '.join((profile, *more))}, expected one that runs a network")
    sensors = args.sensors or study.sensors(ABLATION_SENSORS)
    study.make_folder(args.out)
    found = ablate(AblationPlan(FINAL_SENSORS if args.final else sensors, profile), usable_cores(), Progress())
    study.publish(args, "ablation", ablation_text(found), {"": csv_text(AblationRow, object_rows(found))})
    return 0


def _limits(args: argparse.Namespace) -> int:
    _alone(args, "limits")
    sensors = args.sensors or study.sensors(LIMITS_SENSORS)
    plan = LimitsPlan(FINAL_SENSORS if args.final else sensors, _profiles(args))
    study.make_folder(args.out)
    drawn = study.will_draw(args, "the plots")
    found = limits(plan, usable_cores(), Progress())
    rows = {f"_{kind}": csv_text(type(some[0]), some) for kind, some in found.tables()}
    study.publish(args, "limits", limits_text(found, plan), rows)
    for name, content in (limits_picture.draw(found) if drawn else {}).items():
        study.write(args.out / name, content)
    return 0


def _drag(args: argparse.Namespace) -> int:
    if args.images is not None or args.calibration is not None:
        args.usage_error("--drag is for simulated sensors, not for your own images")
    sensors = FINAL_DRAGGED if args.final else args.sensors or study.sensors(DRAG_SENSORS)
    presses = PRESSES if args.presses is None else args.presses
    plan = DragPlan(sensors, _profiles(args), args.objects or tuple(OBJECTS), args.references or REFERENCES, presses)
    study.make_folder(args.out)
    drawn = study.will_draw(args, "drag.png")
    rows = drag(plan, usable_cores(), Progress())
    study.publish(args, "drag", drag_text(rows), {"": csv_text(DragRow, rows)}, [asdict(row) for row in rows])
    if drawn:
        study.write(args.out / "drag.png", draw_drag(rows))
    return 0


def _sigma(args: argparse.Namespace) -> int:
    if args.images is not None or args.calibration is not None:
        args.usage_error("--sigma is for simulated sensors, not for your own images")
    if args.json:
        args.usage_error("--json does not go with --sigma")
    if "paper" in (profiles := _profiles(args)):
        args.usage_error("--profile: found paper, which tells no errors")
    sensors = FINAL_SENSORS if args.final else args.sensors or study.sensors(DRAG_SENSORS)
    presses = _presses(args)
    plan = SigmaPlan(sensors, profiles, args.objects or tuple(OBJECTS), args.references or REFERENCES, presses)
    study.make_folder(args.out)
    drawn = study.will_draw(args, "sigma.png")
    found = sigma(plan, usable_cores(), Progress())
    study.publish(args, "sigma", sigma_text(found), {"": csv_text(SigmaRow, [each.row for each in found])})
    if drawn:
        study.write(args.out / "sigma.png", draw_sigma(found))
    return 0


def _slip(args: argparse.Namespace) -> int:
    _alone(args, "slip")
    sensors = args.sensors or study.sensors(LIMITS_SENSORS)
    plan = SlipPlan(FINAL_SENSORS[:3] if args.final else sensors, _profiles(args))
    if any(sensor.family != "tacshade" for sensor in plan.sensors):
        args.usage_error("--slip: only sensors of the family tacshade move in time")
    study.make_folder(args.out)
    rows = slip(plan, usable_cores(), Progress())
    kinds = {"_slides": SlideRow, "_held": HeldRow, "_releases": ReleaseRow}
    files = {name: csv_text(kind, [row for row in rows if isinstance(row, kind)]) for name, kind in kinds.items()}
    study.publish(args, "slip", slip_text(rows), files)
    return 0


def _simulated(args: argparse.Namespace) -> int:
    presses = _presses(args)
    if args.references == 0:
        args.usage_error("--references: found 0, expected 1 or more")
    sensors = args.sensors or study.sensors(WORKING_SENSORS)
    plan = Plan(
        sensors=FINAL_SENSORS if args.final else sensors,
        profiles=_profiles(args),
        objects=args.objects or tuple(OBJECTS),
        references=args.references or REFERENCES,
        presses=presses,
    )
    study.make_folder(args.out)
    drawn = study.will_draw(args, "figure6.png", picture.PACKAGES)
    found = evaluate(plan, usable_cores(), Progress())
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
        args.usage_error(f"--presses: found {presses}, expected 0, or {MIN_PRESSES} or more")
    return presses


def _own(args: argparse.Namespace) -> int:
    calibration, cases, mistakes = study.own_images(args)
    rows, timings = evaluate_images(calibration, _profiles(args), cases)
    if not rows:
        raise ConfigError(f"{args.images}: found no image that can be scored, expected one with its truth")
    settings = {"calibration": str(args.calibration), "crc32": f"{calibration.crc32:08x}", "images": str(args.images)}
    _publish(args, rows, timings, settings)
    return 1 if mistakes else 0


def _settings(plan: Plan, found: Evaluation) -> dict[str, Any]:
    """The plan, and each sensor as it is and as it was calibrated."""
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
