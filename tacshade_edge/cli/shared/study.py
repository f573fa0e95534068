"""Parts that the study commands share: options, names of sensors and objects,
the user's own images, output files.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tacshade_edge.calibration import loading
from tacshade_edge.cli.shared.options import add_cluster, add_flag, add_option, warn
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.errors import ConfigError
from tacshade_edge.files.atomic_files import disk_errors
from tacshade_edge.files.images import images_in
from tacshade_edge.files.targets import check_folder, owned_folder
from tacshade_edge.lab.simulator.press import OBJECTS
from tacshade_edge.lab.studies.evaluate.work import Case, SensorName, read_images
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import Calibration
from tacshade_edge.version import how_to_install


def sensors(text: str) -> tuple[SensorName, ...]:
    """Read ``SEED,...``. Raises argparse.ArgumentTypeError."""
    try:
        return tuple(dict.fromkeys(SensorName.parse(word) for word in text.split(",")))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def objects(text: str) -> tuple[str, ...]:
    """Read ``NAME,...``. Raises argparse.ArgumentTypeError."""
    # Each once, in the order in which a person named them.
    names = tuple(dict.fromkeys(word.strip() for word in text.split(",")))
    if unknown := [name for name in names if name not in OBJECTS]:
        raise argparse.ArgumentTypeError(
            f"found {unknown[0]!r}, expected one or more of {', '.join(OBJECTS)}"
        )
    return names


def add_arguments(parser: argparse.ArgumentParser, profiles: str, files: str) -> None:
    """Declare the options of every study; their help quotes `profiles`, the default, and `files`,
    those written.
    """
    text = f"{', '.join(PROFILES)} ({profiles})"
    parser.add_argument("--profile", nargs="+", choices=list(PROFILES), metavar="NAME", help=text)
    add_option(parser, "--out", "DIR", f"folder for {files}")
    add_flag(parser, "--json", "print JSON instead of the tables")
    own = parser.add_argument_group("your own images")
    add_option(own, "--calibration", "CAL.npz", "from `calibrate`")
    add_option(own, "--images", "DIR", "folder of images, each with its ground truth, STEM.npz")


def add_simulated(
    parser: argparse.ArgumentParser, sensor_names: str, object_names: str
) -> argparse._ArgumentGroup:
    """Declare ``--sensors`` and ``--objects`` and return their group."""
    group = parser.add_argument_group("simulated sensors")
    text = f"seeds, or 'default' for the standard one (default: {sensor_names})"
    add_option(group, "--sensors", "SEED,...", text, sensors)
    text = f"objects to press, such as ball,cube (default: {object_names})"
    add_option(group, "--objects", "NAME,...", text, objects)
    add_cluster(group)
    return group


def is_own(args: argparse.Namespace, simulated: tuple[str, ...]) -> bool:
    """Whether to use the user's own images; a usage error if their options are incomplete or
    with `simulated` ones.
    """
    if (args.calibration is None) != (args.images is None):
        args.parser.error("--calibration CAL.npz and --images DIR must be given together")
    if args.images is None:
        return False
    if given := [name for name in simulated if getattr(args, name) is not None]:
        args.parser.error(f"--{given[0]} is for simulated sensors, not for your own images")
    return True


def own_images(args: argparse.Namespace) -> tuple[Calibration, Iterator[Case], list[str]]:
    """The user's calibration, the images, and a list of bad ones that grows.

    Raises ConfigError and DeviceError.
    """
    if not args.images.is_dir():
        raise ConfigError(
            f"{args.images}: found no folder, "
            "expected one with images and their ground truth (.npz)"
        )
    calibration, paths = loading.load(args.calibration), images_in([args.images])
    # Grows while the iterator runs: only its end tells whether the command failed.
    mistakes: list[str] = []
    report = Progress()

    def mistake(text: str) -> None:
        mistakes.append(text)
        report.warn(text)

    return (
        calibration,
        read_images(calibration, args.calibration.name, paths, report, mistake),
        mistakes,
    )


def will_draw(args: argparse.Namespace, files: str) -> bool:
    """Whether plots are wanted and can be drawn; imports nothing,
    and prints a line if matplotlib is missing.
    """
    missing = importlib.util.find_spec("matplotlib") is None
    # A missing picture is no reason to lose the minutes of work behind the tables.
    if args.out and missing:
        warn(f"{files} will be missing without matplotlib: {how_to_install('studies')}")
    return args.out is not None and not missing


def publish(
    args: argparse.Namespace, stem: str, table: str, rows: Mapping[str, str], document: Any = None
) -> None:
    """Print the table or, with --json, the document;
    with --out, write both, and `rows` (end of name: CSV text).
    """
    files = {".md": f"{table}\n"} | {f"{end}.csv": text for end, text in rows.items()}
    if document is not None:
        files[".json"] = json.dumps(document, indent=1) + "\n"
    print(files[".json" if args.json else ".md"], end="")
    if args.out:
        for end, text in files.items():
            write(args.out / f"{stem}{end}", text.encode())


def check_out(args: argparse.Namespace, stem: str, more: Sequence[str] = ()) -> None:
    """Refuse an output folder in which `publish` could not write, or files of the names `more`.
    Raises DeviceError.
    """
    if args.out is not None:
        check_folder(args.out, [*(f"{stem}{end}" for end in (".md", ".csv", ".json")), *more])


def make_folder(folder: Path | None) -> None:
    """Make the output folder, so that an error comes before minutes of work. Raises DeviceError."""
    if folder is not None:
        with disk_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)


def own_folder(args: argparse.Namespace, command: str) -> contextlib.AbstractContextManager[None]:
    """The output folder, if there is one, for this process alone (`owned_folder`), so that an error
    comes before minutes of work.
    """
    return contextlib.nullcontext() if args.out is None else owned_folder(args.out, command)


def write(path: Path, content: bytes) -> None:
    with disk_errors(path):
        path.write_bytes(content)
