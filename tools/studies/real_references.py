"""A set of real frames with each of its free pictures as the reference in turn.

Half of the other free pictures show where a touch begins (`calibrate --rest`), the other half is
judged, and the other way round, if there are enough.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.files.images import read_image
from tacshade_edge.lab.studies.evaluate.labelled import FoundRow, agreements, found_row
from tacshade_edge.lab.studies.evaluate.work import reconstructor
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.contact.rest import LEAST_FRAMES
from tacshade_edge.sensor.inference.rest_evidence import learn_rest
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
    "presses refused or not found",
    "found without a depth",
)
Made = Callable[[Calibration], Calibration]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a profile gives with one reference: how depth follows the label, judged free frames on
    which it finds something, and presses that it refuses or does not find, the most of both halves;
    how many of those that it finds have no depth.
    """

    rank: float
    error_mm: float
    false: int
    lost: int
    no_depth: int


def accepted(sensor: StatedSensor, frame: RealFrame) -> Calibration | None:
    """The calibration of a frame as the only reference; None if it is refused."""
    try:
        return calibrate(sensor, [read_image(frame.path)]).calibration
    except ConfigError:
        return None


def halves(
    calibration: Calibration, free: Sequence[RealFrame]
) -> list[tuple[Calibration, Sequence[RealFrame]]]:
    """The calibration with what half of some free frames show at rest, and the other half."""
    parts = free[::2], free[1::2]
    if min(map(len, parts)) < LEAST_FRAMES:
        return [(calibration, free)]
    made = []
    for rest, judged in (parts, parts[::-1]):
        images = ((frame.path.name, read_image(frame.path)) for frame in rest)
        limits = learn_rest(calibration, images).limits
        made.append((replace(calibration, rest=limits), judged))
    return made


def rows_of_frames(
    calibration: Calibration, profile: str, frames: Sequence[RealFrame]
) -> list[FoundRow]:
    """What a profile finds in frames."""
    one = reconstructor(calibration, profile)
    return [
        found_row(each.path.name, one.step(Frame(0, 0, 0, read_image(each.path))))
        for each in frames
    ]


def is_found(row: FoundRow) -> bool:
    """Whether a frame is usable, and something touches."""
    return not row.refused and (row.contact or row.touched)


def outcome(
    parts: Sequence[tuple[Calibration, Sequence[RealFrame]]],
    profile: str,
    pressed: Sequence[RealFrame],
) -> Outcome:
    """Judge a profile on both halves of the free frames, and on presses."""
    false, lost, no_depth, followed = 0, [], [], []
    for calibration, free in parts:
        false += sum(map(is_found, rows_of_frames(calibration, profile, free)))
        rows = rows_of_frames(calibration, profile, pressed)
        lost.append(sum(not is_found(row) for row in rows))
        no_depth.append(sum(is_found(row) and not row.contact for row in rows))
        known = [frame.known for frame in pressed]
        followed += [each for each in agreements(rows, known) if each.quantity == "depth"]
    return Outcome(
        float(np.mean([each.rank_correlation for each in followed])),
        float(np.mean([each.error for each in followed])),
        false,
        max(lost),
        max(no_depth),
    )


def span(values: Sequence[float], digits: int, of: int | None = None) -> str:
    """The least, median and greatest of some values, and of how many."""
    least, median, most = np.nanpercentile(values, (0, 50, 100))
    text = f"{least:.{digits}f}, {median:.{digits}f}, {most:.{digits}f}"
    return text if of is None else f"{text} of {of}"


def report_each(
    frames: Sequence[RealFrame],
    sensor: StatedSensor,
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
    judged = thinned(pressed, presses)
    tried = [(frame, accepted(sensor, frame)) for frame in thinned(free, references)]
    usable = [(frame, calibration) for frame, calibration in tried if calibration]
    loaded = sum(accepted(sensor, frame) is not None for frame in deep)
    print(f"References: `calibrate` accepts {len(usable)} of {len(tried)} free frames, {loaded} of")
    print(f"{len(deep)} presses of {DEEP_MM:g} mm or more.\n")
    print("Columns show the least, the median and the greatest.\n")
    outcomes: dict[str, list[Outcome]] = {profile: [] for profile in profiles}
    for frame, calibration in usable:
        parts = halves(fitted(calibration), [each for each in free if each is not frame])
        for profile in profiles:
            outcomes[profile].append(outcome(parts, profile, judged))
    lines = [
        (
            profile,
            str(len(some)),
            span([one.rank for one in some], 3),
            span([one.error_mm for one in some], 2),
            span([one.false for one in some], 0, len(free) - 1),
            span([one.lost for one in some], 0, len(judged)),
            span([one.no_depth for one in some], 0),
        )
        for profile, some in outcomes.items()
        if some
    ]
    print(markdown(COLUMNS, lines))
