"""What the commands of studies share: sensors and objects as words, progress, files."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tacshade_edge.errors import DeviceError
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.studies.evaluate.sensors import FINAL_SEED, SensorName


def sensors(text: str) -> tuple[SensorName, ...]:
    """Read ``SEED,...``; those kept for final figures are refused. Raises argparse.ArgumentTypeError."""
    try:
        names = tuple(SensorName.parse(word) for word in text.split(","))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    kept = [name for name in names if name.seed is not None and name.seed >= FINAL_SEED]
    if kept:
        raise argparse.ArgumentTypeError(f"{kept[0]}: seeds from {FINAL_SEED} on are kept for --final")
    return tuple(dict.fromkeys(names))


def objects(text: str) -> tuple[str, ...]:
    """Read ``NAME,...``. Raises argparse.ArgumentTypeError."""
    names = tuple(dict.fromkeys(word.strip() for word in text.split(",")))
    unknown = [name for name in names if name not in OBJECTS]
    if unknown:
        raise argparse.ArgumentTypeError(f"{unknown[0]!r} is not known, expected some of {', '.join(OBJECTS)}")
    return names


def add_own_images(parser: argparse.ArgumentParser) -> None:
    """Take images with their truth in place of simulated sensors."""
    own = parser.add_argument_group("your own images")
    own.add_argument("--calibration", type=Path, metavar="CAL.npz", help="from `calibrate`")
    own.add_argument("--images", type=Path, metavar="DIR", help="images, each with its truth as STEM.npz beside it")


def check_own_images(args: argparse.Namespace) -> None:
    """Both options or none."""
    if (args.calibration is None) != (args.images is None):
        args.usage_error("--calibration CAL.npz and --images DIR belong together")


def make_folder(folder: Path | None) -> None:
    """Before minutes of work, not after. Raises DeviceError."""
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DeviceError(f"{folder}: cannot be written: {error.strerror or error}") from None


def write(path: Path, content: bytes) -> None:
    """Write a file. Raises DeviceError."""
    try:
        path.write_bytes(content)
    except OSError as error:
        raise DeviceError(f"{path}: cannot be written: {error.strerror or error}") from None


def progress(what: str, done: int, total: int) -> None:
    """Say how far it is, where someone looks."""
    if sys.stderr.isatty():
        print(f"\r{what}: {done}/{total} ", end="\n" if done == total else "", file=sys.stderr, flush=True)


def mistake(text: str) -> None:
    """Say what an image cannot be used for, in a line of its own."""
    over = "\r\033[K" if sys.stderr.isatty() else ""  # the line of the progress
    print(f"{over}tacshade-edge: {text}", file=sys.stderr)
