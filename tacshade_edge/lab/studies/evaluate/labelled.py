"""Frames with labels instead of surfaces: how well found depth,
tilt and shear follow the labels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from tacshade_edge.lab.studies.markdown import grouped, markdown, summary, without_nan
from tacshade_edge.reasons import code_of
from tacshade_edge.types import F64, Reconstruction

COLUMNS = ("depth_mm", "tilt_x_deg", "tilt_y_deg", "shear_x_mm", "shear_y_mm")
"""Columns of LABELS.csv that a reconstruction reports too."""
_UNIT = {"depth": "mm", "tilt": "°", "shear": "mm"}
PAIRS = {"tilt": ("tilt_x_deg", "tilt_y_deg"), "shear": ("shear_x_mm", "shear_y_mm")}
"""Quantities with two axes, which need not be the camera's."""


@dataclass(frozen=True, slots=True)
class FoundRow:
    """The result of one profile on one frame; a value that was not found is NaN."""

    image: str
    profile: str
    refused: str  # code of the reason; empty for a usable frame
    contact: bool
    saturated: bool
    degraded: bool
    depth_mm: float  # greatest h; 0 without contact, NaN if only `touched`
    volume_mm3: float
    tilt_x_deg: float  # of the normal of the largest object
    tilt_y_deg: float
    shear_x_mm: float  # mean over all contact cells
    shear_y_mm: float
    touched: bool = False  # something touches, but its depth is unknown


@dataclass(frozen=True, slots=True)
class Agreement:
    """How well one found quantity follows a known one, over frames that were not refused."""

    quantity: str
    frames: int  # for a pair of axes, those that its map was not fitted on
    rank_correlation: float  # Spearman's; for a pair, the mean of both axes
    error: (
        float  # mean absolute error of a line (for a pair, a linear map) fitted on the other half
    )


def found_row(image: str, result: Reconstruction) -> FoundRow:
    """The row of a frame's reconstruction."""
    x, y, z = result.objects[0].normal if result.objects else (math.nan,) * 3
    shear_x, shear_y = result.shear_of_contact_mm or (math.nan, math.nan)
    return FoundRow(
        image,
        result.profile,
        code_of(result.reason),
        result.contact,
        result.saturated,
        result.degraded is not None,
        math.nan if result.touched else result.depth_max_mm,
        math.nan if result.touched else result.volume_mm3,
        # A plane turned about x by an angle has the normal (0, -sin, cos); about y, (sin, 0, cos).
        math.degrees(math.atan2(-y, z)),
        math.degrees(math.atan2(x, z)),
        shear_x,
        shear_y,
        result.touched,
    )


def agreements(rows: Sequence[FoundRow], known: Sequence[Mapping[str, float]]) -> list[Agreement]:
    """Compare found values with known ones, row by row."""
    # Refused frames state nothing, and are counted apart.
    used = [(row, labels) for row, labels in zip(rows, known, strict=True) if not row.refused]
    found = {name: np.array([getattr(row, name) for row, _ in used]) for name in COLUMNS}
    true = {name: np.array([labels.get(name, math.nan) for _, labels in used]) for name in COLUMNS}
    made = [_followed("depth", found["depth_mm"], true["depth_mm"])]
    for quantity, names in PAIRS.items():
        pair = [np.stack([each[name] for name in names], axis=1) for each in (found, true)]
        made.append(_mapped(quantity, pair[0], pair[1]))
    return [each for each in made if each is not None]


COUNTS: dict[str, Callable[[Sequence[FoundRow]], str]] = {
    "frames": lambda some: str(len(some)),
    "refused": lambda some: str(sum(bool(row.refused) for row in some)),
    "without contact": lambda some: str(
        sum(not (row.refused or row.contact or row.touched) for row in some)
    ),
    "touched, depth unknown": lambda some: str(sum(row.touched for row in some)),
    "saturated": lambda some: str(sum(row.saturated for row in some)),
    "degraded": lambda some: str(sum(row.degraded for row in some)),
}


def text(rows: Iterable[FoundRow], made: Mapping[str, Sequence[Agreement]]) -> str:
    """Tables for people: how many frames were refused, and how well the rest agree."""
    counts = summary(
        ("profile",), [((name,), some) for name, some in grouped(rows, "profile").items()], COUNTS
    )
    figures = [
        (
            profile,
            e.quantity,
            str(e.frames),
            f"{e.rank_correlation:.2f}",
            f"{e.error:.2f} {_UNIT[e.quantity]}",
        )
        for profile, some in made.items()
        for e in some
    ]
    return (
        f"{counts}\n"
        "\n"
        f"{markdown(('profile', 'quantity', 'frames', 'rank correlation', 'mean error'), figures)}"
    )


def _followed(quantity: str, found: F64, true: F64) -> Agreement | None:
    """Compare one quantity with another; fit a line on every other frame
    and score it on the rest.
    """
    there = np.isfinite(found) & np.isfinite(true)
    found, true = found[there], true[there]
    # A line through two points, and two to judge it by.
    if len(found) < 4:
        return None
    # Every other frame, not halves: loads drift in the course of a recording.
    fit, rest = slice(0, None, 2), slice(1, None, 2)
    line = np.polynomial.Polynomial.fit(found[fit], true[fit], 1)
    error = float(np.abs(line(found[rest]) - true[rest]).mean())
    return Agreement(quantity, len(found), spearman(found, true), error)


def _mapped(quantity: str, found: F64, true: F64) -> Agreement | None:
    """Map found (N, n) linearly to two true axes (N, 2);
    fit on every other frame and score on the rest.
    """
    there = np.isfinite(found).all(axis=1) & np.isfinite(true).all(axis=1)
    found, true = found[there], true[there]
    if len(found) < 4 * found.shape[1]:
        return None
    # Linear, since tilt and shear of a robot have axes, signs and origins of their own.
    to_true, *_ = np.linalg.lstsq(found[::2], true[::2], rcond=None)
    mapped, rest = found[1::2] @ to_true, true[1::2]
    both = [spearman(mapped[:, k], rest[:, k]) for k in (0, 1)]
    error = float(np.linalg.norm(mapped - rest, axis=1).mean())
    return Agreement(quantity, len(rest), float(np.mean(both)), error)


def spearman(one: F64, other: F64) -> float:
    """Spearman's rank correlation; NaN if one does not vary."""
    # The import takes a second, which whoever does not rank need not spend.
    from scipy.stats import rankdata

    # Mean ranks for equal values, as labels are often rounded.
    a, b = (rankdata(values) - (len(values) + 1) / 2 for values in (one, other))
    scale = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / scale if scale > 0 else math.nan


def document(
    rows: Sequence[FoundRow], made: Mapping[str, Sequence[Agreement]]
) -> dict[str, object]:
    """The rows and agreements for JSON."""
    agreements = {name: [asdict(each) for each in some] for name, some in made.items()}
    found: dict[str, object] = without_nan(
        {"frames": [asdict(row) for row in rows], "agreements": agreements}
    )
    return found
