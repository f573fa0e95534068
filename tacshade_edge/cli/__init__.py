"""The commands: each parses its arguments, calls a room and prints.

In: words of a command line. Out: text, JSON, files and exit codes.
Threads: none.
Other rooms use: `entry`. The command line imports only the module of the command that runs.
"""

from __future__ import annotations

import argparse
import errno
import importlib
import json
import sys
from collections.abc import Callable, Sequence
from typing import Any

from tacshade_edge.cli.shared.journal import complain
from tacshade_edge.cli.streams import STDOUT, drop_stdout
from tacshade_edge.errors import ConfigError, TacshadeError
from tacshade_edge.quoting import escaped, shown
from tacshade_edge.requirements import PACKAGES_FIX, missing_requirements
from tacshade_edge.version import installed_version

_MISTAKES = (
    errno.ENAMETOOLONG,
    errno.EACCES,
    errno.ELOOP,
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EISDIR,
    errno.EEXIST,
)
# The length of a printed error, which may list all expected values.
_CHARS_MAX = 4000
# 2 is argparse's. 78 is EX_CONFIG of sysexits.h: the unit's RestartPreventExitStatus, because no
# restart mends a settings file.
EXIT_OK, EXIT_FAILED, EXIT_USAGE, EXIT_CONFIG = 0, 1, 2, 78
# As a shell reports a command that SIGINT ended: 128 + 2.
EXIT_INTERRUPTED = 130

# name -> (module with add_arguments(parser) and run(args) -> exit code, one line of help)
COMMANDS: dict[str, tuple[str, str]] = {
    "run": (
        "run",
        "run the daemon, which turns camera images into height maps and publishes them over MQTT",
    ),
    "demo": ("demo", "show simulated sensors live in a browser; no real sensor is needed"),
    "check-config": ("check_config", "check a settings file, or export its JSON Schema"),
    "doctor": ("doctor", "diagnose the camera, broker, serial ports and clock, and suggest fixes"),
    "capture": (
        "capture",
        "take a sensor's reference images and presses step by step; start here with a new sensor",
    ),
    "calibrate": (
        "calibrate",
        "turn images of the untouched skin and of ball presses into a calibration file",
    ),
    "reconstruct": ("reconstruct", "turn images into height maps, point clouds and a summary"),
    "teach": ("teach", "learn an object by name from a few touches of it"),
    "recognise": ("recognise", "name the taught objects that images show"),
    "record": ("record", "ask the running daemon to make a recording that `replay` can read"),
    "replay": (
        "replay",
        "reconstruct a recording again and write or publish the results, or compare two runs",
    ),
    "backup": (
        "backup",
        "save a board's settings, calibrations, objects and maps in one file, or restore them",
    ),
    "export": ("export", "convert a recording to MCAP, CSV or PLY for other tools"),
    "dashboard": (
        "dashboard",
        "serve a web page with live height maps, a 3-D view and sensor health",
    ),
    "bridge": ("bridge", "serve live data to Foxglove, Lichtblick and Prometheus"),
    "evaluate": (
        "evaluate",
        "score profiles against ground truth, using the paper's Experiment 1 or your own images",
    ),
    "tradeoff": (
        "tradeoff",
        "measure speed and accuracy of profiles here, and choose one for a budget",
    ),
    "stitch": (
        "stitch",
        (
            "combine images and the robot's poses into one large map, "
            "and score it against a known surface"
        ),
    ),
    "completion": ("completion", "print a shell script that completes commands and options"),
    "simulate": (
        "simulate",
        "write simulated images with truth, calibration sets, scans, MuJoCo files",
    ),
}


def _report_requirements(problems: Sequence[str], *, as_json: bool) -> int:
    """Print what `doctor` cannot even start with; return the exit code."""
    if as_json:
        check = {"check": "packages", "state": "fault", "fix": PACKAGES_FIX}
        print(json.dumps([check | {"found": problem} for problem in problems], indent=2))
    else:
        for problem in problems:
            complain(f"tacshade-edge: {escaped(problem, _CHARS_MAX)}")
        complain(f"tacshade-edge: {PACKAGES_FIX}")
    return EXIT_CONFIG


class _Version(argparse.Action):
    """Prints the version; looks it up only when requested."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(f"{parser.prog} {installed_version()}")
        parser.exit()


def command_line(
    is_wanted: Callable[[str], bool],
) -> tuple[argparse.ArgumentParser, dict[str, Any]]:
    """Return the command line's parser and the modules of the wanted commands;
    only these get their options.
    """
    parser = argparse.ArgumentParser(
        prog="tacshade-edge",
        description="Measure metric shape by touch with TacShade sensors.",
        epilog="tacshade-edge COMMAND --help lists a command's options.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    modules = {}
    for name, (module_name, summary) in COMMANDS.items():
        sub = commands.add_parser(
            name, help=summary, description=summary[0].upper() + summary[1:] + "."
        )
        sub.set_defaults(parser=sub)
        if is_wanted(name):
            modules[name] = importlib.import_module(f"tacshade_edge.cli.commands.{module_name}")
            modules[name].add_arguments(sub)
    return parser, modules


def _run(module: Any, args: argparse.Namespace) -> int:
    """Run a command; what fails because of other versions of packages says so."""
    try:
        return int(module.run(args))
    except (TacshadeError, OSError):
        raise
    except Exception as error:
        if not (problems := missing_requirements()):
            raise
        code = _report_requirements(problems, as_json=False)
        # Whoever asks what is wrong has the answer; elsewhere it may be another defect.
        if args.command != "doctor":
            raise
        found = escaped(f"{type(error).__name__}: {error}", _CHARS_MAX)
        complain(f"tacshade-edge: doctor ended early: {found}")
        return code


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 1 failed, 2 wrong usage,
    78 bad configuration.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    # No option before the command takes a value, so the first other word is the command. Only its
    # module is imported: all together take seconds on a small board.
    chosen = next((w for w in words if not w.startswith("-")), None)
    try:
        parser, modules = command_line(lambda name: name == chosen)
    except Exception:
        # Another package's start may raise anything; a defect of ours keeps its traceback.
        if not (problems := missing_requirements()):
            raise
        return _report_requirements(problems, as_json=chosen == "doctor" and "--json" in words)
    args, unknown = parser.parse_known_args(words)
    if unknown:
        # Of the command's own parser, whose usage line is the one that helps.
        args.parser.error(f"unrecognized arguments: {' '.join(unknown)}")
    module = modules[args.command]
    try:
        return _run(module, args)
    except ConfigError as error:
        for line in (str(error), *error.others):
            complain(f"tacshade-edge: {escaped(line, _CHARS_MAX)}")
        return EXIT_CONFIG
    except TacshadeError as error:
        complain(f"tacshade-edge: {escaped(str(error), _CHARS_MAX)}")
        return EXIT_FAILED
    except BrokenPipeError:
        # The reader of our output closed it, as `| head` does.
        drop_stdout()
        return EXIT_FAILED
    except OSError as error:
        # A path that Python could not even look at: too long a name, a closed folder; or the disk
        # that our output goes to. Any other error, and any of a daemon, is a defect and has to show
        # its traceback.
        if error.filename == STDOUT:
            drop_stdout()
        elif error.filename is None or args.command == "run":
            raise
        complain(f"tacshade-edge: {shown(error.filename)}: {error.strerror}")
        return EXIT_CONFIG if error.errno in _MISTAKES else EXIT_FAILED
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
