"""``calibrate --labels``: learns touch quantities from labelled images, and says how well."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from tacshade_edge.calibration.files.labels import LabelledImage
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.images import read_image, size_text
from tacshade_edge.plausibility.suspicions import SuspicionCode
from tacshade_edge.quoting import counted
from tacshade_edge.sensor.inference.network import LabelledFrame, TouchResult, learn_touch
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.touch.learning import LEAST_GROUPS, LEAST_ROWS
from tacshade_edge.types import QUANTITIES, Calibration, TouchModel

_SHOWN = 3
"""Frames named in a warning; more would hide the other warnings."""


def check_labelled(table: Path, labelled: Sequence[LabelledImage], size: str) -> None:
    """Refuse what `learn_touches` would refuse only after minutes: too few rows of every quantity,
    and images that are unreadable or not of the references' `size`.

    Raises ConfigError.
    """
    counts = {name: sum(name in row.known for row in labelled) for name in QUANTITIES}
    if max(counts.values()) < LEAST_ROWS:
        found = ", ".join(
            f"{counted(count, 'row')} with {name}" for name, count in counts.items() if count
        )
        raise ConfigError(
            f"{table}: found {found}, expected at least {LEAST_ROWS} rows with the same quantity"
        )
    progress = Progress()
    for _ in _frames(labelled, size, partial(progress, "labelled frames")):
        pass
    progress.end()


def learn_touches(
    calibration: Calibration, table: Path, labelled: Sequence[LabelledImage]
) -> list[TouchResult]:
    """Learn a touch model per profile.

    Raises ConfigError for an unreadable image or too few usable rows of every quantity.
    """
    size = f"{calibration.image_width_px}x{calibration.image_height_px}"
    results, progress = [], Progress()
    for profile in PROFILES.values():
        # `paper` has no network to learn from.
        if profile.network is not None:
            frames = _frames(labelled, size, partial(progress, f"frames ({profile.name})"))
            results.append(learn_touch(calibration, profile, frames))
            if wrong := [one for one in results[-1].suspected if one.impossible]:
                progress.end()
                raise ConfigError(f"{table}: {'; '.join(map(str, wrong))}")
    progress.end()
    if not any(one.learnt.reports for one in results):
        raise ConfigError(
            f"{table}: cannot learn any quantity: {'; '.join(touch_warnings(results[:1]))}"
        )
    return results


def _frames(
    labelled: Sequence[LabelledImage], size: str, report: Callable[[int, int], None]
) -> Iterator[LabelledFrame]:
    for done, row in enumerate(labelled, start=1):
        try:
            image = read_image(row.path)
        except DecodeError as error:
            raise ConfigError(f"{row.where}: image: {error}") from None
        if size_text(image) != size:
            raise ConfigError(
                f"{row.where}: image: {row.path}: found {size_text(image)} px, expected {size} px"
            )
        yield LabelledFrame(row.where, image, row.known, row.group, row.path.name)
        report(done, len(labelled))


def touch_models(results: Sequence[TouchResult]) -> Mapping[str, TouchModel]:
    """The learnt models by profile."""
    return {one.profile: one.learnt.model for one in results if one.learnt.model is not None}


def touch_warnings(results: Sequence[TouchResult]) -> tuple[str, ...]:
    """Return warnings about frames that were left out and quantities with too few rows."""
    # Each profile looks at the same labels, and sees them a little differently.
    doubts = [doubt for one in results for doubt in one.suspected]
    first = {(doubt.code, doubt.values.get("name")): doubt for doubt in reversed(doubts)}
    lines = list(map(str, reversed(first.values())))
    constant = {name for code, name in first if code is SuspicionCode.LABEL_CONSTANT}
    for one in results:
        if one.left_out:
            shown = "; ".join(one.left_out[:_SHOWN]) + (
                "; ..." if len(one.left_out) > _SHOWN else ""
            )
            lines.append(f"{one.profile}: left out {len(one.left_out)} labelled frames: {shown}")
        few = {name: found for name, found in one.too_few.items() if name not in constant}
        for name, (rows, groups) in few.items():
            found = f"found {rows} usable rows in {groups} groups"
            expected = (
                f"expected at least {LEAST_ROWS} rows in {LEAST_GROUPS} groups, of different values"
            )
            lines.append(f"{one.profile}: {name}: {found}, {expected}; left out")
    return tuple(lines)


def touch_report(results: Sequence[TouchResult]) -> dict[str, Any]:
    touch = {}
    for one in results:
        reports = {each.name: asdict(each) for each in one.learnt.reports}
        for report in reports.values():
            report["contradicting"] = [one.names[row] for row in report["contradicting"]]
        touch[one.profile] = {
            "frames": len(one.names),
            "left_out": list(one.left_out),
            "quantities": reports,
        }
    return {"touch": touch}
