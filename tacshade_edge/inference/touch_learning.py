"""Learns a profile's touch model from labelled frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.profiles import Profile
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.core.touch.answer import imprint_of
from tacshade_edge.core.touch.learning import LEAST_GROUPS, LEAST_ROWS, LearntTouch, learn
from tacshade_edge.inference.network import SHEAR, load_network, touch_networks
from tacshade_edge.types import F32, QUANTITIES, U8, Calibration, Frame, Need


@dataclass(frozen=True, slots=True)
class LabelledFrame:
    """A picture's name in the table, its labels, and its group (empty: a group of its own)."""

    name: str
    image: U8
    known: Mapping[str, float]
    group: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class TouchResult:
    """What a profile learnt from a table.

    `names` are the frames that were used, which the reports number; `left_out` has a line for each other one; `too_few`
    are the rows and groups of each quantity that has too few.
    """

    profile: str
    learnt: LearntTouch
    names: tuple[str, ...]
    left_out: tuple[str, ...]
    too_few: Mapping[str, tuple[int, int]]


def learn_touch(calibration: Calibration, profile: Profile, frames: Iterable[LabelledFrame]) -> TouchResult:
    """Learn a profile's touch model; the profile must have a network."""
    assert profile.network is not None
    fitted = calibration.fitted.get(profile.name), calibration.fitted.get(SHEAR)
    taken: list[F32] = []
    reconstructor = Reconstructor(calibration, profile, load_network(profile.network, *fitted), touch=taken)
    names, left_out, known, groups, imprints = [], [], [], [], []
    for frame in frames:
        made = reconstructor.step(Frame(0, 0, 0, frame.image), need=Need.TOUCH)
        if made is None or not made.valid or not made.contact:
            why = "found no contact" if made is None or made.valid else str(made.reason)
            left_out.append(f"{frame.name}: {why}")
            continue
        names.append(frame.name)
        imprints.append(imprint_of(made.objects, made.volume_mm3))
        known.append(frame.known)
        groups.append(frame.group or f"\0{len(names)}")
    labels = np.array([[one.get(name, np.nan) for name in QUANTITIES] for one in known]).reshape(-1, len(QUANTITIES))
    counts = np.isfinite(labels).sum(axis=0)
    numbers = np.unique(groups, return_inverse=True)[1].astype(np.int64)
    presses = np.array([len(np.unique(numbers[np.isfinite(column)])) for column in labels.T])
    enough = (counts >= LEAST_ROWS) & (presses >= LEAST_GROUPS)
    used = np.flatnonzero(enough)
    too_few = {QUANTITIES[q]: (int(counts[q]), int(presses[q])) for q in np.flatnonzero((counts > 0) & ~enough)}
    learnt = LearntTouch(None, ())
    if len(used):
        chosen = [QUANTITIES[q] for q in used]
        networks = touch_networks(profile.network, *fitted)
        learnt = learn(np.stack(taken), np.stack(imprints), chosen, labels[:, used], numbers, networks)
    return TouchResult(profile.name, learnt, tuple(names), tuple(left_out), too_few)


def report_lines(result: TouchResult) -> Sequence[str]:
    """The result as lines of text."""
    lines = [f"touch model of {result.profile}: {len(result.names)} frames"]
    for each in result.learnt.reports:
        unit = UNITS[each.name.rpartition("_")[2]]
        if not each.seen:
            lines.append(f"  {each.name}: not visible in these frames (R² {each.r2:.2f}): no answer")
            continue
        lines.append(
            f"  {each.name}: off by {each.error:.3g} {unit} (R² {each.r2:.2f}; 90 % intervals hold "
            f"{100 * each.coverage_90:.0f} %); expect {each.error_twice:.3g} with twice the labels, "
            f"{each.error_four_times:.3g} with four times"
        )
        if each.contradicting:
            rows = ", ".join(result.names[row] for row in each.contradicting[:SHOWN])
            more = f" and {len(each.contradicting) - SHOWN} more" if len(each.contradicting) > SHOWN else ""
            lines.append(f"    contradict the others: {rows}{more}")
    return lines


UNITS = {"mm": "mm", "deg": "°", "n": "N", "nmm": "N mm"}
"""Symbol of the unit at the end of a quantity's name."""

SHOWN = 5
"""Greatest number of rows that a line names."""
