"""``tacshade-edge check-config``: checks a settings file as far as possible without hardware."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence

from tacshade_edge.calibration import loading
from tacshade_edge.camera.sources import make_source
from tacshade_edge.cli.shared.finger_places import finger_doubt
from tacshade_edge.cli.shared.options import DEFAULT_CONFIG, add_flag, add_option
from tacshade_edge.errors import ConfigError
from tacshade_edge.mqtt import links
from tacshade_edge.reasons import Reason
from tacshade_edge.robot.ports import check_serial
from tacshade_edge.settings import (
    Document,
    check_source,
    file_schema,
    load_all,
    load_hand,
)
from tacshade_edge.types import Calibration


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_option(
        parser,
        "file",
        "FILE",
        "settings file (default: %(default)s)",
        nargs="?",
        default=DEFAULT_CONFIG,
    )
    add_flag(parser, "--schema", "print the JSON Schema of settings files")


def run(args: argparse.Namespace) -> int:
    """Print ``FILE: ok``, or raise a ConfigError that lists all mistakes."""
    if args.schema:
        print(json.dumps(file_schema(), indent=2))
        return 0
    documents, mistakes, warnings = load_all(args.file), list[str](), list[str]()
    calibrations = dict[str, Calibration]()
    # load_all ends at the file's first mistake; these look at what it names, each for itself.
    checks = (
        check_source,
        check_serial,
        links.check_link,
        loading.find_calibration,
    )
    for document in documents:
        for check in checks:
            try:
                found = check(document)
            except ConfigError as error:
                mistakes.append(str(error))
            else:
                if isinstance(found, Reason):
                    warnings.append(f"{document.where('calibration')}: warning: {found}")
                elif isinstance(found, Calibration):
                    calibrations[document.settings.sensor_id] = found
    warnings += _doubted_fingers(documents, calibrations)
    if hand := load_hand(args.file):
        try:
            links.check_link(hand)
        except ConfigError as error:
            mistakes.append(str(error))
    # What all sensors share, such as the broker, would be named once for each of them.
    if mistakes := list(dict.fromkeys(mistakes)):
        raise ConfigError(mistakes[0], others=mistakes[1:])
    for document in documents:
        # As `run` makes it, but not opened: a file may be checked where its camera is not.
        make_source(document.settings.source)
    print(f"{args.file}: ok", *warnings, sep="\n")
    return 0


def _doubted_fingers(
    documents: Sequence[Document], calibrations: Mapping[str, Calibration]
) -> list[str]:
    doubt = finger_doubt(documents, calibrations)
    return [f"{doubt[0]}: warning: {doubt[1]}"] if doubt else []
