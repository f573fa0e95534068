"""``tacshade-edge calibrate --labels``: learns a touch model for each profile that has a network."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.touch.learning import LEAST_GROUPS, LEAST_ROWS
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.inference.touch_learning import LabelledFrame, TouchResult, learn_touch
from tacshade_edge.storage.images import read_image
from tacshade_edge.storage.tables.labels import LabelledImage
from tacshade_edge.types import QUANTITIES, Calibration

_SHOWN = 3


def learn_from_labels(calibration: Calibration, table: Path, labelled: Sequence[LabelledImage]) -> list[TouchResult]:
    """Learn a touch model per profile. Raises ConfigError for an unreadable image or too few rows of every quantity."""
    counts = {name: sum(name in row.known for row in labelled) for name in QUANTITIES}
    if max(counts.values()) < LEAST_ROWS:
        found = ", ".join(f"{count} rows with {name}" for name, count in counts.items() if count)
        raise ConfigError(f"{table}: found {found}, expected at least {LEAST_ROWS} rows with the same quantity")
    size = (calibration.image_height_px, calibration.image_width_px)
    results = []
    progress = Progress()
    for profile in PROFILES.values():
        if profile.network is not None:
            frames = _frames(labelled, size, partial(progress, f"frames ({profile.name})"))
            results.append(learn_touch(calibration, profile, frames))
    progress.end()
    if not any(one.learnt.reports for one in results):
        why = "; ".join(touch_warnings(results[:1]))
        raise ConfigError(f"{table}: cannot learn any quantity: {why}")
    return results


def _frames(
    labelled: Sequence[LabelledImage], size: tuple[int, int], report: Callable[[int, int], None]
) -> Iterator[LabelledFrame]:
    for done, row in enumerate(labelled, start=1):
        try:
            image = read_image(row.path)
        except DecodeError as error:
            raise ConfigError(f"{row.where}: image: {error}") from None
        if image.shape[:2] != size:
            found = f"{image.shape[1]}x{image.shape[0]} px"
            raise ConfigError(f"{row.where}: image: {row.path}: found {found}, expected {size[1]}x{size[0]} px")
        yield LabelledFrame(row.where, image, row.known, row.group)
        report(done, len(labelled))


def touch_warnings(results: Sequence[TouchResult]) -> tuple[str, ...]:
    """Return warnings about frames that were left out and quantities with too few rows."""
    lines = []
    for one in results:
        if one.left_out:
            shown = "; ".join(one.left_out[:_SHOWN]) + ("; ..." if len(one.left_out) > _SHOWN else "")
            lines.append(f"{one.profile}: left out {len(one.left_out)} labelled frames: {shown}")
        for name, (rows, groups) in one.too_few.items():
            found = f"found {rows} usable rows in {groups} groups"
            expected = f"expected at least {LEAST_ROWS} rows in {LEAST_GROUPS} groups"
            lines.append(f"{one.profile}: {name}: {found}, {expected}; left out")
    return tuple(lines)


def touch_report(results: Sequence[TouchResult]) -> dict[str, Any]:
    """Return the touch models' figures for ``--json``."""
    if not results:
        return {}
    return {
        "touch": {
            one.profile: {
                "frames": len(one.names),
                "left_out": list(one.left_out),
                "quantities": {
                    each.name: asdict(each) | {"contradicting": [one.names[row] for row in each.contradicting]}
                    for each in one.learnt.reports
                },
            }
            for one in results
        }
    }
