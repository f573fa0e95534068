"""``calibrate --rest``: the images of the untouched skin, and what they show in words."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.cli.shared.options import add_option
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.recording.recording import Entry, Recording
from tacshade_edge.sensor.contact.rest import FALSE_CONTACTS
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.inference.rest_evidence import LearntRest, learn_rest
from tacshade_edge.sensor.profiles import DEFAULT, PROFILES
from tacshade_edge.types import U8, Calibration, Frame

IMAGES_MAX = 300
"""More are thinned evenly: neighbours in a stream show the same, and each takes 20 ms."""
REFERENCES_LEAST = 5
"""Fewer references are too much like their own mean to count as frames at rest."""
_RATE_LEAST, _RATE_MOST = 1e-9, 0.1
_SHOWN = 3


def add_rest(parser: argparse.ArgumentParser) -> None:
    """Declare ``--rest`` and ``--false-contacts``."""
    text = "pictures of the untouched sensor: where touches begin"
    add_option(parser, "--rest", "DIR|RECORDING", text)
    text = "untouched frames taken for touches (default: 0.0001)"
    add_option(parser, "--false-contacts", "RATE", text, _rate)


def _rate(text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        # In no range, so that both mistakes give the same line.
        rate = math.nan
    if not _RATE_LEAST <= rate <= _RATE_MOST:
        raise argparse.ArgumentTypeError(f"found {text}, expected 1e-9 to 0.1")
    return rate


def check_rest(path: Path) -> None:
    """Refuse pictures that `rest_of` could read only after minutes of other work to no avail.
    Raises ConfigError.
    """
    try:
        found = sum(1 for _ in _images(path))
        if not found:
            raise ConfigError("found no image, expected pictures of the untouched skin")
    except ConfigError as error:
        raise _of_option(path, error) from None


def rest_of(
    args: argparse.Namespace, calibration: Calibration, references: Sequence[U8]
) -> LearntRest:
    """Measure the limits on the images that ``--rest`` names, and on the references,
    if there are enough.

    Raises ConfigError.
    """
    # The references were taken of the untouched sensor too.
    named = [(f"reference {k}", image) for k, image in enumerate(references, start=1)]
    counting = named if len(named) >= REFERENCES_LEAST else []
    rate = FALSE_CONTACTS if args.false_contacts is None else args.false_contacts
    try:
        return learn_rest(calibration, chain(counting, _images(args.rest)), rate)
    except ConfigError as error:
        raise _of_option(args.rest, error) from None


def _of_option(path: Path, error: ConfigError) -> ConfigError:
    # The errors of a recording name it already.
    text = str(error) if str(error).startswith(str(path)) else f"{path}: {error}"
    return ConfigError(f"--rest: {text}")


def _images(path: Path) -> Iterator[tuple[str, U8]]:
    # Rounded up, so that at most IMAGES_MAX are left. Only reading a recording tells its length.
    every = max(-(-sum(1 for _ in _entries(path)) // IMAGES_MAX), 1)
    for entry in _entries(path):
        if entry.seq % every == 0:
            try:
                yield entry.row.image, entry.picture()
            except DecodeError as error:
                raise ConfigError(f"{entry.row.image}: {error}") from None


def _entries(path: Path) -> Iterator[Entry]:
    return iter(Recording(path).next_entry, None)


def rest_report(learnt: LearntRest) -> dict[str, Any]:
    """What ``--json`` prints of it."""
    return {
        "rest": {
            name: {
                "frames": limits.frames,
                "false_contacts": limits.false_contacts,
                "height_mm": round(limits.height_mm, 4),
                "local_change": round(limits.local_change, 4),
                "changed_part": round(limits.changed_part, 4),
            }
            for name, limits in learnt.limits.items()
        }
    }


def rest_lines(
    learnt: LearntRest, calibration: Calibration, presses: Sequence[KnownPress] = ()
) -> list[str]:
    """The result in words, with what the default profile finds of the presses."""
    limits = learnt.limits[DEFAULT]
    one_in = round(1 / limits.false_contacts)
    lines = [
        (
            f"rest: {limits.frames} frames; at most one untouched frame in {one_in:,} is taken for "
            "a touch"
        ),
        f"  {DEFAULT} reports a touch from {limits.height_mm:.2f} mm of its own heights on,"
        " which may be less than the true ones on a skin that it does not know",
    ]
    if presses:
        # With the new limits: whether they hide presses is what a person has to know of them.
        made = make_reconstructor(replace(calibration, rest=learnt.limits), PROFILES[DEFAULT])
        results = [(made.step(Frame(0, 0, 0, press.image)), press.depth_mm) for press in presses]
        missed_mm = [depth for one, depth in results if not (one.contact or one.touched)]
        deepest = f", the deepest missed one of {max(missed_mm):.2f} mm" if missed_mm else ""
        shallowest = f"the shallowest one of {min(depth for _, depth in results):.2f} mm"
        found = f"{len(results) - len(missed_mm)} of {len(results)} presses"
        lines.append(f"  it finds {found} ({shallowest}{deepest})")
    return lines


def rest_warnings(learnt: LearntRest) -> tuple[str, ...]:
    """A line about images that were left out."""
    if not learnt.left_out:
        return ()
    shown = "; ".join(learnt.left_out[:_SHOWN]) + ("; ..." if len(learnt.left_out) > _SHOWN else "")
    return (f"rest: left out {len(learnt.left_out)} images: {shown}",)
