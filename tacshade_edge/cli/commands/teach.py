"""``tacshade-edge teach``: learns an object by name from a few touches."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import objects_file
from tacshade_edge.calibration.files.objects_file import Known
from tacshade_edge.cli.shared.options import (
    DEFAULT_CONFIG,
    add_flag,
    add_option,
    add_sensor,
    number,
    warn,
)
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.cli.shared.touches import TOO_LIGHT, touched_images, without_names
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files.images import images_in
from tacshade_edge.files.targets import check_file, one_at_a_time
from tacshade_edge.library.frames import open as open_camera
from tacshade_edge.library.result import Result, Results
from tacshade_edge.library.subscriber import listen
from tacshade_edge.mqtt import links
from tacshade_edge.quoting import counted
from tacshade_edge.sensor.geometry.disc import Grid, disc_rays
from tacshade_edge.sensor.geometry.disc_map import with_finite_radius
from tacshade_edge.sensor.profiles import LADDER, PROFILES
from tacshade_edge.sensor.recognition.naming import describe_touch
from tacshade_edge.settings import Document, load
from tacshade_edge.types import F32, HeightMap

TOUCHES = 3
"""Touches that `teach --live` takes if the user names no number."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", metavar="NAME", help="name of the object, without spaces")
    text = "image of one touch of the object, or folder of such images"
    add_option(parser, "images", "IMG", text, nargs="*")
    add_option(
        parser, "--calibration", "CAL.npz", "from `calibrate`; the objects' file is beside it"
    )
    text = "teach only this profile (default: fast, balanced and accurate)"
    parser.add_argument("--profile", choices=sorted(PROFILES), help=text)
    text = "take the touches from the daemon of these settings, or if none runs, from their camera"
    add_flag(parser, "--live", text)
    text = f"settings file of --live (default: {DEFAULT_CONFIG})"
    add_option(parser, "--config", "FILE", text, default=DEFAULT_CONFIG)
    add_sensor(parser)
    some = number(
        f"a whole number from 1 to {objects_file.TOUCHES_MAX}", 1, objects_file.TOUCHES_MAX, int
    )
    add_option(
        parser,
        "--touches",
        "N",
        f"touches that --live takes (default: {TOUCHES})",
        some,
        default=TOUCHES,
    )
    add_flag(parser, "--forget", "forget the object instead")


def run(args: argparse.Namespace) -> int:
    """Teach; return 1 if some of the images could not be used."""
    name = objects_file.check_name(args.name)
    document = load(args.config, args.sensor) if args.live else None
    if (document is None) == (args.calibration is None):
        found = "found both" if args.live else "found neither"
        raise ConfigError(f"--calibration, --live: {found}, expected one of them")
    if bool(args.images) == (args.live or args.forget):
        found, expected = ("images", "none") if args.images else ("no image", "at least one")
        raise ConfigError(f"IMG: found {found}, expected {expected} here")
    calibration = Path(document.settings.calibration if document else args.calibration)
    path = objects_file.path_beside(calibration)
    check_file(path)
    if document is not None and not args.forget:
        return _live(document, path, name, args.touches)
    # From the reading to the writing: two at once would each store what the other did not know.
    with _alone(path):
        if args.forget:
            return _forget(path, name)
        profiles = LADDER if args.profile is None else (args.profile,)
        return _from_images(calibration, path, name, profiles, images_in(args.images))


def _alone(path: Path) -> contextlib.AbstractContextManager[None]:
    return one_at_a_time(path, "teach", "changing")


def _forget(path: Path, name: str) -> int:
    known = objects_file.load(path)
    if name not in _names(known):
        raise ConfigError(f"{path}: found no object {name}, expected one of {_listed(known)}")
    left = objects_file.without(known, name)
    objects_file.save(path, left)
    print(f"{path}: forgot {name}; {_listed(left)}")
    return 0


def _from_images(
    calibration_path: Path, path: Path, name: str, profiles: Iterable[str], images: list[Path]
) -> int:
    calibration, profiles = loading.load(calibration_path), tuple(profiles)
    progress, used, known = Progress(), 0, calibration.known
    for touched in touched_images(without_names(calibration), profiles, images, progress):
        if touched is None:
            continue
        found = {
            profile: each for profile, each in touched.descriptions.items() if each is not None
        }
        # All profiles or none: `auto` would otherwise forget the object as it changes to another.
        if len(found) < len(profiles):
            progress.warn(f"{touched.name}: {TOO_LIGHT}")
            continue
        for profile, each in found.items():
            known = objects_file.taught(known, profile, name, each[None])
        used += 1
    if not used:
        raise ConfigError(f"{name}: {TOO_LIGHT} in any image")
    objects_file.save(path, known)
    _report(path, name, used, known)
    return 0 if used == len(images) else 1


def _live(document: Document, path: Path, name: str, wanted: int) -> int:
    """Take one description from each contact, and store it at once."""
    # A damaged file would be found only after the first touch.
    objects_file.load(path)
    with contextlib.closing(_results(document)) as results:
        print(
            f"touch {name} {counted(wanted, 'time')}, each time in another place or turn",
            flush=True,
        )
        for taken, (profile, description, depth_mm) in enumerate(_described(results), 1):
            # Read anew each time: touches take minutes, in which somebody else may teach as well.
            with _alone(path):
                before = objects_file.load(path)
                known = objects_file.taught(before, profile, name, description[None])
                objects_file.save(path, known)
            print(f"touch {taken} of {wanted}: {depth_mm:.2f} mm deep", flush=True)
            if taken == wanted:
                _report(path, name, wanted, known)
                return 0
    raise DeviceError(f"{name}: the frames ended before {counted(wanted, 'touch')}")


def _results(document: Document) -> Results:
    """The daemon's results, or those of the settings' camera if no daemon publishes any."""
    address = links.broker_address(document)
    try:
        return listen(
            f"{address['host']}:{address['port']}",
            document.settings.sensor_id,
            username=address["username"],
            password=address["password"],
            ca_file=address["tls_ca"],
        )
    except DeviceError as error:
        warn(f"no daemon is heard, so the camera is opened: {error}")
        return open_camera(document.path)


def _described(results: Iterable[Result]) -> Iterator[tuple[str, F32, float]]:
    """The profile, description and depth of each contact that is over and was firm enough."""
    for deepest in deepest_of_each(results):
        height = HeightMap(
            deepest.height_mm, deepest.contact, deepest.row0, deepest.col0, deepest.step_px
        )
        rows, cols = deepest.height_mm.shape
        grid = Grid(rows, cols, deepest.row0, deepest.col0, deepest.step_px)
        rays = disc_rays(grid, deepest.geometry)
        description = describe_touch(height, rays, with_finite_radius(deepest.geometry))
        if description is None:
            warn(TOO_LIGHT)
        else:
            yield deepest.profile, np.asarray(description), deepest.depth_max_mm


def deepest_of_each(results: Iterable[Result]) -> Iterator[Result]:
    """Yield the result of the deepest frame of each contact, after its end."""
    deepest: Result | None = None
    for result in results:
        # Neither shows a form, and a contact may go on behind them.
        if not result.valid or result.touched:
            continue
        if result.in_contact:
            if deepest is None or result.depth_max_mm > deepest.depth_max_mm:
                deepest = result
        elif deepest is not None:
            yield deepest
            deepest = None
    if deepest is not None:
        yield deepest


def _report(path: Path, name: str, used: int, known: Known) -> None:
    print(f"{path}: taught {name} by {counted(used, 'touch')}; {_listed(known)}")


def _names(known: Known) -> list[str]:
    return sorted({each.name for objects in known.values() for each in objects})


def _listed(known: Known) -> str:
    names = _names(known)
    return f"{counted(len(names), 'object')} known{': ' if names else ''}{', '.join(names)}"
