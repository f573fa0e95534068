"""``tacshade-edge doctor``: finds faults of a sensor and its machine and suggests fixes,
or judges pictures.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path

from tacshade_edge.calibration import loading
from tacshade_edge.cli import EXIT_CONFIG, EXIT_FAILED, EXIT_OK
from tacshade_edge.cli.shared.options import (
    add_config,
    add_flag,
    add_option,
    add_profile,
    add_sensor,
)
from tacshade_edge.doctor import Finding, State
from tacshade_edge.doctor.bundle import Seen, write_bundle
from tacshade_edge.doctor.diagnose import SETTINGS, diagnose
from tacshade_edge.doctor.judged_pictures import doubts, figures, judge_pictures
from tacshade_edge.doctor.machine import Machine
from tacshade_edge.doctor.tail import check_tail, measure_tail
from tacshade_edge.errors import ConfigError
from tacshade_edge.files.images import images_in, read_image
from tacshade_edge.files.targets import check_file
from tacshade_edge.quoting import escaped
from tacshade_edge.quoting import shown as shown_path
from tacshade_edge.reasons import Reason
from tacshade_edge.sensor.depth.learned import is_flat
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.settings import load
from tacshade_edge.types import Calibration

_COLOURS: dict[State, int] = {"ok": 32, "warning": 33, "fault": 31}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_config(parser)
    add_sensor(parser)
    add_option(
        parser,
        "--bundle",
        "FILE",
        "write a zip file of diagnostics that you can send when you ask for help",
    )
    add_flag(parser, "--with-frame", "with --bundle: add a picture from the camera")
    add_flag(
        parser, "--json", "print {check, state, found, fix}, or each picture's figures, as JSON"
    )
    add_flag(
        parser,
        "--tail",
        "only measure, in ten seconds, how late this machine ends the same work, and name what "
        "helps",
    )
    add_option(
        parser, "--calibration", "CAL.npz", "with images: instead of the settings' calibration"
    )
    add_profile(parser)
    add_option(
        parser,
        "images",
        "IMG",
        "show only which judge refuses each of these images, and why",
        nargs="*",
    )


def run(args: argparse.Namespace) -> int:
    """Print every finding; return 78 for bad settings and 1 for any other fault."""
    _check_options(args)
    if args.images:
        return _judge(_calibration(args), args.profile, args.images, as_json=args.json)
    if args.bundle is not None:
        check_file(args.bundle)
    findings, seen, machine = [], Seen(), Machine()
    found = (
        check_tail(machine, measure_tail())
        if args.tail
        else diagnose(args.config, machine, seen, args.sensor)
    )
    # A person may have switched colours off everywhere: https://no-color.org.
    colour = sys.stdout.isatty() and "NO_COLOR" not in os.environ
    # Checks can take seconds: each finding is shown as it comes.
    for finding in found:
        findings.append(finding)
        if not args.json:
            print(shown(finding, colour=colour), flush=True)
    if args.bundle is not None:
        write_bundle(args.bundle, findings, seen, with_frame=args.with_frame)
    faults, warnings = (
        [each for each in findings if each.state == state] for state in ("fault", "warning")
    )
    if args.json:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        counts = f"faults: {len(faults)}, warnings: {len(warnings)}"
        print(counts if faults or warnings else "all is well")
        if args.bundle is not None:
            print(f"wrote {args.bundle}; look through it before you share it")
    # As every other command returns for such a file; without settings, the other findings say
    # little.
    if any(finding.check == SETTINGS for finding in faults):
        return EXIT_CONFIG
    return EXIT_FAILED if faults else EXIT_OK


def _check_options(args: argparse.Namespace) -> None:
    """End with a usage error if options contradict each other."""
    mistakes = {
        "--with-frame: found no --bundle FILE, expected both": args.with_frame
        and args.bundle is None,
        "--bundle: found images to judge as well, expected one of the two": args.images
        and args.bundle is not None,
        "--calibration: found no image to judge, expected at least one": args.calibration
        and not args.images,
        "--tail: found images or --bundle as well, expected one of the three": args.tail
        and (args.images or args.bundle is not None),
    }
    for mistake, is_made in mistakes.items():
        if is_made:
            args.parser.error(mistake)


def shown(finding: Finding, *, colour: bool) -> str:
    state = f"{finding.state:<7}"
    if colour:
        state = f"\x1b[{_COLOURS[finding.state]}m{state}\x1b[0m"
    line = f"{state}  {finding.check:<17}  {escaped(finding.found)}"
    return f"{line}\n{' ' * 9}-> {escaped(finding.fix)}" if finding.fix else line


def _calibration(args: argparse.Namespace) -> Calibration:
    if args.calibration is not None:
        # Whoever asks what is wrong with a file does not want it replaced by a newer one.
        return loading.load(args.calibration, store=False)
    found = loading.find_calibration(load(args.config, args.sensor))
    if isinstance(found, Reason):
        raise ConfigError(f"{found.text}; or pass --calibration CAL.npz", code=found.code)
    return found


def _judge(calibration: Calibration, profile: str, paths: Sequence[Path], *, as_json: bool) -> int:
    """Print what the judges say of each picture, then which maps do not explain theirs;
    return 1 if a picture is refused, or most maps explain nothing.
    """
    foreign = False
    judged = list(judge_pictures(calibration, profile, images_in(paths)))
    passing = [each.path for each in judged if not each.reason]
    if as_json:
        left = _shares_left(calibration, profile, passing)
        _, foreign = doubts(left)
        records = [each.as_dict() | {"unexplained": left.get(each.path)} for each in judged]
        print(json.dumps(records, indent=2))
    else:
        for each in judged:
            named = shown_path(each.path)
            why = ""
            if each.reason:
                why = f"  {each.judge}: {escaped(each.reason.text.removeprefix(f'{named}: '))}"
            print(f"{'refused' if each.reason else 'passes':<8} {named}{why}")
        print("", *figures(judged), "", sep="\n")
        print(f"{len(passing)} of {len(judged)} pass", flush=True)
        # Finding a print takes up to a minute: whoever wants no more than the judges has read them
        # by now.
        lines, foreign = doubts(_shares_left(calibration, profile, passing))
        for line in lines:
            print(line)
    return EXIT_FAILED if foreign or len(passing) < len(judged) else EXIT_OK


def _shares_left(
    calibration: Calibration, profile: str, paths: Sequence[Path]
) -> dict[Path, float]:
    """The share of each picture's change that its map leaves unexplained, of those that changed;
    without the extra `fit`, for a flat skin, and for a profile without a network nothing is known.
    """
    known = PROFILES[profile].network is not None and not is_flat(calibration.geometry)
    # The judges need none of these packages, and their answer stands without this figure.
    if not paths or not known or not all(map(find_spec, ("numba", "scipy"))):
        return {}
    from tacshade_edge.lab.fitting.explained import shares_left
    from tacshade_edge.lab.fitting.identify import identify

    print("holding maps against their pictures, up to a minute", file=sys.stderr)
    images = [read_image(path) for path in paths]
    found = shares_left(calibration, identify(calibration), profile, images)
    return {path: left for path, left in zip(paths, found, strict=True) if left is not None}
