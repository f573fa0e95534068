"""``tacshade-edge recognise``: names the taught objects that images show."""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import objects_file
from tacshade_edge.cli.shared.options import add_flag, add_option, add_profile
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.cli.shared.touches import touched_images
from tacshade_edge.errors import ConfigError
from tacshade_edge.files.images import images_in
from tacshade_edge.sensor.inference.object_names import make_recogniser
from tacshade_edge.sensor.recognition.answer import Answer
from tacshade_edge.types import F32


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_option(parser, "--calibration", "CAL.npz", "from `calibrate`", required=True)
    add_profile(parser)
    text = "all images show one object, so that together they give one answer"
    add_flag(parser, "--same-object", text)
    add_flag(parser, "--json", "print the answers as JSON")
    add_option(parser, "images", "IMG", "image, or folder of images", nargs="+")


def run(args: argparse.Namespace) -> int:
    """Print a line for each object, or one for all images; return 1 if an image could
    not be used.
    """
    images = images_in(args.images)
    calibration = loading.load(args.calibration)
    known = calibration.known.get(args.profile)
    # The profiles' networks see different depths, so each has descriptions of its own.
    if not known:
        path = objects_file.path_beside(args.calibration)
        expected = "expected some, from `tacshade-edge teach`"
        raise ConfigError(f"{path}: found no object that {args.profile} was taught, {expected}")
    progress, records, seen, unusable = Progress(), list[dict[str, Any]](), list[F32](), 0
    for touched in touched_images(calibration, (args.profile,), images, progress):
        if touched is None:
            unusable += 1
            continue
        objects = [
            {"label": each.label, **_answer(Answer(each.name, each.probability))}
            for each in touched.results[args.profile].objects
        ]
        unmeasured = touched.results[args.profile].touched
        records.append({"image": touched.name, "objects": objects, "touched": unmeasured})
        description = touched.descriptions[args.profile]
        if description is not None:
            seen.append(description)
    together = None
    if args.same_object:
        # Together: one touch may fit several objects, and all of them only one.
        answer = make_recogniser(known).answer(np.stack(seen)) if seen else Answer()
        together = {"touches": len(seen), **_answer(answer)}
    if args.json:
        whole = {} if together is None else {"same_object": together}
        print(json.dumps({"images": records, **whole}, indent=2))
    elif together is not None:
        print(f"{len(seen)} of {len(images)} images: {_text(together)}")
    else:
        for record in records:
            none = "touched, depth unknown" if record["touched"] else "no contact"
            found = ", ".join(map(_text, record["objects"])) or none
            print(f"{record['image']}: {found}")
    return 1 if unusable else 0


def _answer(answer: Answer) -> dict[str, Any]:
    probability = answer.probability
    return {
        "name": answer.name,
        "probability": None if probability is None else round(probability, 3),
    }


def _text(answer: dict[str, Any]) -> str:
    if answer["name"] is None:
        return "unknown"
    return f"{answer['name']} ({100 * answer['probability']:.0f} %)"
