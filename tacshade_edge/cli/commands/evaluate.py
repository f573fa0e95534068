"""``tacshade-edge evaluate``: the paper's Experiment 1 on simulated sensors,
or a score of the user's own images.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from numpy.exceptions import RankWarning

from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.calibration.files.labels import LabelledImage, read_labels
from tacshade_edge.calibration.presses.press_selection import MIN_PRESSES
from tacshade_edge.calibration.sentences import sentence
from tacshade_edge.cli.shared import study
from tacshade_edge.cli.shared.finding_options import WITH_OPTIONS
from tacshade_edge.cli.shared.options import COUNT, add_option, warn
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.images import read_image
from tacshade_edge.lab.parallel import workers
from tacshade_edge.lab.simulator.press import OBJECTS
from tacshade_edge.lab.studies.evaluate import accuracy
from tacshade_edge.lab.studies.evaluate import labelled as labels
from tacshade_edge.lab.studies.evaluate.label_doubts import label_doubts
from tacshade_edge.lab.studies.evaluate.score import Row
from tacshade_edge.lab.studies.evaluate.touch_scores import (
    TouchRow,
    scored,
    touch_agreements,
    touch_rows,
    touch_text,
    unscored,
)
from tacshade_edge.lab.studies.evaluate.work import (
    PRESSES,
    REFERENCES,
    evaluate,
    reconstructor,
    score_cases,
)
from tacshade_edge.lab.studies.markdown import csv_text, without_nan
from tacshade_edge.quoting import encodable
from tacshade_edge.reasons import text_of
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import QUANTITIES, Calibration, Frame

WORKING_SENSORS = "default,5,11,21"
SIMULATED = ("sensors", "objects", "presses", "references", "cluster")
"""Options that are only for simulated sensors."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    files = "evaluation.md, evaluation.csv and evaluation.json"
    study.add_arguments(parser, "default: all", files)
    own = parser.add_argument_group("your own frames with labels instead of surfaces")
    add_option(
        own,
        "--labels",
        "CSV",
        f"table of image and quantities, such as {', '.join(labels.COLUMNS)}",
    )
    simulated = study.add_simulated(parser, WORKING_SENSORS, "all")
    add_option(simulated, "--presses", "N", "ball presses in each calibration (default: 40)", COUNT)
    add_option(simulated, "--references", "N", "references in each calibration (default: 8)", COUNT)


def run(args: argparse.Namespace) -> int:
    with study.own_folder(args, "evaluate"):
        if args.labels is not None:
            return _labelled(args)
        return _own(args) if study.is_own(args, SIMULATED) else _simulated(args)


def _profiles(args: argparse.Namespace) -> tuple[str, ...]:
    return tuple(dict.fromkeys(args.profile or PROFILES))


def _simulated(args: argparse.Namespace) -> int:
    presses = PRESSES if args.presses is None else args.presses
    # None at all asks for references alone; too few would be refused only after the pictures are
    # drawn.
    if 0 < presses < MIN_PRESSES:
        args.parser.error(f"--presses: found {presses}, expected 0 or at least {MIN_PRESSES}")
    if args.references == 0:
        args.parser.error("--references: found 0, expected at least 1")
    names, profiles = args.sensors or study.sensors(WORKING_SENSORS), _profiles(args)
    objects, references = args.objects or tuple(OBJECTS), args.references or REFERENCES
    study.check_out(args, "evaluation")
    with workers(args.cluster) as pool:
        rows, found = evaluate(
            names, profiles, objects, pool, Progress(), references=references, presses=presses
        )
    sensors = [
        {
            "name": str(name),
            "model": asdict(name.make().model),
            "fit": calibration_file.fit_figures(made.calibration.fit),
            "warnings": [sentence(warning, WITH_OPTIONS) for warning in made.warnings],
        }
        for name, made in zip(names, found, strict=True)
    ]
    settings = {
        "profiles": profiles,
        "objects": objects,
        "references": references,
        "presses": presses,
    }
    _publish(args, rows, {**settings, "sensors": sensors})
    return 0


def _own(args: argparse.Namespace) -> int:
    study.check_out(args, "evaluation")
    calibration, cases, mistakes = study.own_images(args)
    rows = score_cases(calibration, _profiles(args), cases)
    if not rows:
        raise ConfigError(
            f"{args.images}: found no image to score, expected at least one image with a truth file"
        )
    settings = {
        "calibration": str(args.calibration),
        "crc32": f"{calibration.crc32:08x}",
        "images": str(args.images),
    }
    _publish(args, rows, settings)
    refused = {row.image: row.degraded for row in rows if not row.valid}
    for image, why in refused.items():
        warn(f"{image}: invalid: {why}")
    return 1 if mistakes or refused else 0


def _publish(args: argparse.Namespace, rows: Sequence[Row], settings: Mapping[str, Any]) -> None:
    document = accuracy.document(rows, settings)
    study.publish(args, "evaluation", accuracy.table(rows), {"": csv_text(Row, rows)}, document)


def _labelled(args: argparse.Namespace) -> int:
    """Reconstruct each frame on its own, print how well the results follow the labels,
    and write rows.
    """
    if given := [name for name in SIMULATED if getattr(args, name) is not None]:
        args.parser.error(f"--{given[0]} cannot be used with --labels")
    if args.images is None or args.calibration is None:
        args.parser.error("--labels requires --images DIR and --calibration CAL.npz")
    table, profiles = read_labels(args.labels, args.images), _profiles(args)
    calibration = loading.load(args.calibration, store=False)
    study.check_out(args, "labels", ["labels-touch.csv"])
    found = _compared(calibration, profiles, table)
    if not found.known:
        raise ConfigError(
            f"{args.labels}: found no readable image, expected at least one in {args.images}"
        )
    _publish_labelled(args, found)
    # Of another sensor's calibration every frame is refused; a table of nothing would look like a
    # result.
    if not any(row.contact or not row.refused for some in found.rows.values() for row in some):
        warn(
            f"{args.images}: every frame is invalid, the first: {found.refused}; are they this "
            "calibration's?"
        )
        return 1
    return 1 if found.mistakes else 0


@dataclass(slots=True)
class _Compared:
    """What each profile found in the labelled frames, and what no profile compares."""

    rows: dict[str, list[labels.FoundRow]]
    touches: dict[str, list[TouchRow]]
    unscored: list[str]
    known: list[Mapping[str, float]] = field(default_factory=list)
    mistakes: int = 0
    refused: str = ""


def _compared(
    calibration: Calibration, profiles: Sequence[str], table: Sequence[LabelledImage]
) -> _Compared:
    # One for all frames: a network is loaded once.
    made = {profile: reconstructor(calibration, profile) for profile in profiles}
    columns = [name for name in QUANTITIES if any(name in each.known for each in table)]
    names = {
        profile: scored(one.quantities, columns, learnt=profile in calibration.touch)
        for profile, one in made.items()
    }
    found = _Compared(
        {profile: [] for profile in profiles},
        {profile: [] for profile in profiles},
        [
            line
            for profile, one in made.items()
            for line in unscored(columns, profile, one.quantities, names[profile])
        ],
    )
    progress = Progress()
    for k, each in enumerate(table):
        progress("frames", k, len(table))
        try:
            image = read_image(each.path)
        except DecodeError as error:
            progress.warn(error)
            found.mistakes += 1
            continue
        found.known.append(each.known)
        name = encodable(each.path.name)
        for profile, one in made.items():
            result = one.step(Frame(0, 0, 0, image))
            found.refused = found.refused or text_of(result.reason)
            found.rows[profile].append(labels.found_row(name, result))
            found.touches[profile] += touch_rows(name, each.known, names[profile], result)
    progress("frames", len(table), len(table))
    return found


def _publish_labelled(args: argparse.Namespace, found: _Compared) -> None:
    with warnings.catch_warnings():
        # Of equal depths no line has a slope; the table says it, by a rank correlation of nan.
        warnings.simplefilter("ignore", RankWarning)
        made = {
            profile: labels.agreements(some, found.known) for profile, some in found.rows.items()
        }
    touch = {profile: touch_agreements(some) for profile, some in found.touches.items()}
    every = [row for some in found.rows.values() for row in some]
    touches = [row for some in found.touches.values() for row in some]
    text, files = labels.text(every, made), {"": csv_text(labels.FoundRow, every)}
    document = labels.document(every, made)
    document["touch"] = without_nan(
        {name: [asdict(one) for one in some] for name, some in touch.items()}
    )
    if touches:
        text += f"\n\n{touch_text(touch)}"
        files["-touch"] = csv_text(TouchRow, touches)
    study.publish(args, "labels", text, files, document)
    doubts = label_doubts(found.rows, found.known, touch)
    for line in (*found.unscored, *(f"{args.labels}: {doubt}" for doubt in doubts)):
        warn(line)
