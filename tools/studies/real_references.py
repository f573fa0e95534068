"""A set of real frames with each of its free pictures as the reference in turn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.inputs import Sensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.storage.images import read_image
from tacshade_edge.studies.evaluate.labelled import FoundRow, agreements, found_row
from tacshade_edge.studies.evaluate.work import reconstructor
from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import Calibration, Frame
from tools.studies.real_sets import RealFrame, thinned

DEEP_MM = 2.0
"""Stated depth from which a press must not serve as a reference."""
DEEP_TRIED = 100
COLUMNS = (
    "profile",
    "references",
    "rank of depth",
    "mean error, mm",
    "found on free frames",
    "presses refused or empty",
)
Made = Callable[[Calibration], Calibration]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a profile gives with one reference: how depth follows the label, other free frames on
    which it finds something, and presses that it refuses or does not find.
    """

    rank: float
    error_mm: float
    false: int
    lost: int


def accepted(sensor: Sensor, frame: RealFrame) -> Calibration | None:
    """The calibration of a frame as the only reference; None if it is refused."""
    try:
        return calibrate(sensor, [read_image(frame.path)]).calibration
    except ConfigError:
        return None


def outcome(frames: Sequence[RealFrame], rows: Sequence[FoundRow], reference: RealFrame) -> Outcome:
    """Judge one profile's rows of all frames."""
    pairs = list(zip(frames, rows, strict=True))
    found = [not row.refused and (row.contact or row.touched) for row in rows]
    followed = [
        a for a in agreements(rows, [frame.known for frame in frames]) if a.quantity == "depth"
    ]
    depth = followed[0] if followed else None
    return Outcome(
        depth.rank_correlation if depth else float("nan"),
        depth.error if depth else float("nan"),
        sum(
            yes
            for (frame, _), yes in zip(pairs, found, strict=True)
            if frame.free and frame is not reference
        ),
        sum(not yes for (frame, _), yes in zip(pairs, found, strict=True) if frame.free is False),
    )


def span(values: Sequence[float], digits: int, of: int | None = None) -> str:
    """The least, median and greatest of some values, and of how many."""
    least, median, most = np.nanpercentile(values, (0, 50, 100))
    text = f"{least:.{digits}f}, {median:.{digits}f}, {most:.{digits}f}"
    return text if of is None else f"{text} of {of}"


def report_each(
    frames: Sequence[RealFrame],
    sensor: Sensor,
    profiles: Sequence[str],
    counts: tuple[int, int],
    fitted: Made,
) -> None:
    """Print the distribution over a number of free frames, each the reference in turn, judged by at
    most a number of presses.
    """
    references, presses = counts
    free = [frame for frame in frames if frame.free]
    pressed = [frame for frame in frames if frame.free is False]
    deep = thinned([f for f in pressed if f.known.get("depth_mm", 0) >= DEEP_MM], DEEP_TRIED)
    judged = [*free, *thinned(pressed, presses)]
    tried = [(frame, accepted(sensor, frame)) for frame in thinned(free, references)]
    usable = [(frame, calibration) for frame, calibration in tried if calibration]
    loaded = sum(accepted(sensor, frame) is not None for frame in deep)
    print(f"References: `calibrate` accepts {len(usable)} of {len(tried)} free frames, {loaded} of")
    print(f"{len(deep)} presses of {DEEP_MM:g} mm or more.\n")
    print("Columns show the least, the median and the greatest.\n")
    outcomes: dict[str, list[Outcome]] = {profile: [] for profile in profiles}
    for frame, calibration in usable:
        made = fitted(calibration)
        for profile in profiles:
            one = reconstructor(made, profile)
            rows = [
                found_row(each.path.name, one.step(Frame(0, 0, 0, read_image(each.path))))
                for each in judged
            ]
            outcomes[profile].append(outcome(judged, rows, frame))
    lines = [
        (
            profile,
            str(len(some)),
            span([one.rank for one in some], 3),
            span([one.error_mm for one in some], 2),
            span([one.false for one in some], 0, len(free) - 1),
            span([one.lost for one in some], 0, len(judged) - len(free)),
        )
        for profile, some in outcomes.items()
        if some
    ]
    print(markdown(COLUMNS, lines))
