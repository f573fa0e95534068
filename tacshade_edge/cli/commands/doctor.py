"""``tacshade-edge doctor``: finds faults of a sensor and its machine and suggests fixes."""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import asdict
from pathlib import Path

from tacshade_edge.cli import EXIT_CONFIG, EXIT_FAILED, EXIT_OK
from tacshade_edge.cli.commands.check_config import DEFAULT_CONFIG, add_sensor
from tacshade_edge.doctor import Finding, State
from tacshade_edge.doctor.bundle import Seen, write_bundle
from tacshade_edge.doctor.diagnose import SETTINGS, diagnose
from tacshade_edge.doctor.machine import Machine
from tacshade_edge.quoting import escaped

_COLOURS: dict[State, int] = {"ok": 32, "warning": 33, "fault": 31}
_INDENT = " " * 9


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--config", type=Path, default=DEFAULT_CONFIG, metavar="FILE", help="settings file (default: %(default)s)"
    )
    add_sensor(parser)
    parser.add_argument(
        "--bundle",
        type=Path,
        metavar="FILE",
        help="write a zip file of diagnostics that you can send when you ask for help",
    )
    parser.add_argument(
        "--with-frame", action="store_true", help="with --bundle: add a picture from the camera to the zip file"
    )
    parser.set_defaults(refuse=parser.error)
    parser.add_argument(
        "--json", action="store_true", help="print the findings as JSON: a list of {check, state, found, fix}"
    )


def run(args: argparse.Namespace) -> int:
    """Print every finding; return 78 for bad settings and 1 for any other fault."""
    if args.with_frame and args.bundle is None:
        args.refuse("--with-frame: found no --bundle FILE, expected both")
    findings, seen = [], Seen()
    for finding in diagnose(args.config, Machine(), seen, args.sensor):
        findings.append(finding)
        if not args.json:
            print(shown(finding, colour=sys.stdout.isatty() and "NO_COLOR" not in os.environ), flush=True)
    if args.bundle is not None:
        write_bundle(args.bundle, findings, seen, with_frame=args.with_frame)
    if args.json:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        print(_summary(findings))
        if args.bundle is not None:
            print(f"wrote {args.bundle}; look through it before you share it")
    faults = {finding.check for finding in findings if finding.state == "fault"}
    if SETTINGS in faults:
        return EXIT_CONFIG
    return EXIT_FAILED if faults else EXIT_OK


def shown(finding: Finding, *, colour: bool) -> str:
    """The finding as text: a line, and the fix in a second line."""
    state = f"{finding.state:<7}"
    if colour:
        state = f"\x1b[{_COLOURS[finding.state]}m{state}\x1b[0m"
    line = f"{state}  {finding.check:<17}  {escaped(finding.found)}"
    return f"{line}\n{_INDENT}-> {escaped(finding.fix)}" if finding.fix else line


def _summary(findings: list[Finding]) -> str:
    faults, warnings = (sum(finding.state == state for finding in findings) for state in ("fault", "warning"))
    if not faults and not warnings:
        return "all is well"
    return f"{faults} fault{'' if faults == 1 else 's'}, {warnings} warning{'' if warnings == 1 else 's'}"
