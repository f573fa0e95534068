"""``tacshade-edge evaluate --labels``: compares results from a user's own frames with labels, such as a robot's."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence

from tacshade_edge.cli.shared import study
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.factories import calibrations
from tacshade_edge.settings.sensor_file import read_sensor
from tacshade_edge.storage.images import read_image
from tacshade_edge.storage.tables.labels import LabelledImage, read_labels
from tacshade_edge.studies.evaluate.labelled import FoundRow, agreements, document, draw, found_row, text
from tacshade_edge.studies.evaluate.sensors import reconstructor
from tacshade_edge.studies.tables import csv_text
from tacshade_edge.types import Calibration, Frame


def run(args: argparse.Namespace, profiles: Sequence[str]) -> int:
    """Reconstruct each frame on its own, print how well the results follow the labels, and write rows and plots."""
    labelled = read_labels(args.labels, args.images)
    calibration = _calibration(args, labelled)
    study.make_folder(args.out)
    drawn = study.will_draw(args, "labels.png")
    made = {profile: reconstructor(calibration, profile) for profile in profiles}
    rows: dict[str, list[FoundRow]] = {profile: [] for profile in profiles}
    used, mistakes = [], 0
    progress = Progress()
    for k, each in enumerate(labelled):
        progress("frames", k, len(labelled))
        try:
            image = read_image(each.path)
        except DecodeError as error:
            progress.say(f"tacshade-edge: {error}")
            mistakes += 1
            continue
        used.append(each)
        for profile, one in made.items():
            rows[profile].append(found_row(each.path.name, one.step(Frame(0, 0, 0, image))))
    progress("frames", len(labelled), len(labelled))
    if not used:
        raise ConfigError(f"{args.labels}: found no readable image, expected at least one in {args.images}")
    known = [each.known for each in used]
    figures = {profile: agreements(some, known) for profile, some in rows.items()}
    every = [row for some in rows.values() for row in some]
    study.publish(args, "labels", text(every, figures), {"": csv_text(FoundRow, every)}, document(every, figures))
    if drawn:
        study.write(args.out / "labels.png", draw(rows, known))
    return 1 if mistakes else 0


def _calibration(args: argparse.Namespace, labelled: Sequence[LabelledImage]) -> Calibration:
    """The user's calibration, or one made from SENSOR.yaml and the references, by default the least loaded frame."""
    if args.calibration is not None:
        return calibrations.load(args.calibration, store=False)
    paths = args.reference or [min(labelled, key=_load).path]
    if not args.reference:
        print(f"tacshade-edge: using {paths[0]}, the least loaded frame, as the reference", file=sys.stderr)
    try:
        references = [read_image(path) for path in paths]
    except DecodeError as error:
        raise ConfigError(str(error)) from None
    result = calibrate(read_sensor(args.sensor), references, allow_loaded_reference=True)
    for warning in result.warnings:
        print(f"tacshade-edge: {warning}", file=sys.stderr)
    return result.calibration


def _load(each: LabelledImage) -> tuple[float, float]:
    """Sort key for the load: depth, then shear; an unknown depth comes last and an unknown shear counts as 0."""
    shear = math.hypot(each.known.get("shear_x_mm", 0.0), each.known.get("shear_y_mm", 0.0))
    return each.known.get("depth_mm", math.inf), shear
