"""Turn the rows into figures, and the figures into a text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from tacshade_edge.studies.tables import markdown
from tools.studies.limits.disturbances import BEYOND
from tools.studies.limits.rows import DepthRow, DisturbedRow, FineRow, Found, NullRow
from tools.studies.limits.work import Limits, Plan

DETECTED = 0.95
"""Share of presses that must be found for a depth to count as detected."""
RESOLVED = 0.75
"""Share of places at which a gap or ridge must be resolved."""
DIP_PART, LEAST_DIP_MM, RIDGE_OFF = 0.5, 0.05, 0.2
"""A gap is resolved if h dips by at least half of the true dip, and a ridge if its height is within a fifth."""
WRONG = 0.25
"""Relative error above which a depth counts as wrong."""


def profiles_of(rows: Iterable[Found]) -> list[str]:
    """List the profiles in the order of the rows."""
    return list(dict.fromkeys(r.profile for r in rows))


def detected(rows: Sequence[DepthRow], profile: str, radius_mm: float) -> list[tuple[float, float]]:
    """Compute (depth, share of presses found) of a ball."""
    some = [r for r in rows if r.profile == profile and r.radius_mm == radius_mm]
    depths = sorted({r.depth_mm for r in some})
    return [(d, float(np.mean([r.contact for r in some if r.depth_mm == d]))) for d in depths]


def depth_errors(rows: Sequence[DepthRow], profile: str, name: str) -> list[tuple[float, float, float, float]]:
    """Compute (depth, mean absolute error, its 90th percentile, share reported as saturated) of an object, in mm."""
    some = [r for r in rows if r.profile == profile and r.object == name]
    made = []
    for depth in sorted({r.depth_mm for r in some}):
        here = [r for r in some if r.depth_mm == depth]
        off = np.abs([r.found_mm - r.true_mm for r in here])
        saturated = float(np.mean([r.saturated for r in here]))
        made.append((depth, float(off.mean()), float(np.quantile(off, 0.9)), saturated))
    return made


def dips(row: FineRow) -> bool:
    """Whether the height dips between two bars by at least half of the true dip."""
    return row.found_height_mm >= max(DIP_PART * row.true_height_mm, LEAST_DIP_MM)


def two(row: FineRow) -> bool:
    """Whether two bars are found as two objects."""
    return row.objects == 2


def ridge_right(row: FineRow) -> bool:
    """Whether a ridge's height is within a fifth of the true one."""
    return abs(row.found_height_mm / row.true_height_mm - 1) <= RIDGE_OFF


FINE = {
    "gap: two objects": ("bars", two),
    "gap: half the dip": ("bars", dips),
    "ridge: height within 20 %": ("ridge", ridge_right),
}
"""The questions about fine shapes, with the shape and the test of each."""


def finest(rows: Sequence[FineRow], profile: str, pitch_mm: float, question: str) -> float:
    """Find the size at and above which a shape is resolved at `RESOLVED` of the places; infinity if there is none."""
    shape, came_out = FINE[question]
    some = [r for r in rows if r.profile == profile and r.pitch_mm == pitch_mm and r.shape == shape]
    least = float("inf")
    for size in sorted({r.size_mm for r in some}, reverse=True):
        if np.mean([came_out(r) for r in some if r.size_mm == size]) < RESOLVED:
            break
        least = size
    return least


def silently_wrong(rows: Iterable[DisturbedRow]) -> list[DisturbedRow]:
    """List the contacts that are lost or have a wrong depth without any warning in the result."""
    return [r for r in rows if r.silent and r.off > WRONG]


def text(found: Limits, plan: Plan) -> str:
    """Write the tables, for a terminal and a document."""
    profiles = profiles_of(found.nulls)
    parts = (
        ("Nothing touches", _nulls(found.nulls, profiles)),
        ("The least depth: part of the presses that is found, %", _faint(found.faint, profiles)),
        ("The greatest depth: error of the greatest h, mm", _deep(found.deep, profiles)),
        ("The finest shape, mm", _fine(found.fine, profiles, plan)),
        ("A contact of 2 mm, disturbed: change of its depth, %", _disturbed(found.disturbed, profiles)),
    )
    return "\n\n".join(f"{title}\n\n{table}" for title, table in parts)


def _nulls(rows: Sequence[NullRow], profiles: Sequence[str]) -> str:
    lines = []
    kinds = list(dict.fromkeys(r.disturbance for r in rows))
    within = [k for k in kinds if k not in BEYOND]
    groups = [
        *((k, [k]) for k in within),
        ("all of these", within),
        *((f"beyond: {k}", [k]) for k in kinds[len(within) :]),
    ]
    for title, group in groups:
        for profile in profiles:
            some = [r for r in rows if r.profile == profile and r.disturbance in group]
            silent = sum(r.contact and not r.doubt for r in some)
            lines.append(
                [
                    title,
                    profile,
                    str(len(some)),
                    str(sum(not r.valid for r in some)),
                    str(sum(r.valid and bool(r.doubt) for r in some)),
                    str(sum(r.contact for r in some)),
                    str(silent),
                    f"{max(r.found_mm for r in some):.2f}",
                ]
            )
    header = ["what", "method", "frames", "invalid", "degraded", "phantoms", "silent ones", "deepest mm"]
    return markdown(header, lines)


def _faint(rows: Sequence[DepthRow], profiles: Sequence[str]) -> str:
    lines, depths = [], sorted({r.depth_mm for r in rows})
    for radius in sorted({r.radius_mm for r in rows}):
        for profile in profiles:
            known = detected(rows, profile, radius)
            lines.append([f"ball, radius {radius:g} mm", profile, *(f"{100 * part:.0f}" for _, part in known)])
    return markdown(["object", "method", *(f"{d:g} mm" for d in depths)], lines)


def _deep(rows: Sequence[DepthRow], profiles: Sequence[str]) -> str:
    lines = []
    depths = [d for d in sorted({r.depth_mm for r in rows}) if d == round(d)]
    for name in dict.fromkeys(r.object for r in rows):
        for profile in profiles:
            known = {d: rest for d, *rest in depth_errors(rows, profile, name)}
            for k, (what, form) in enumerate((("mean", ".2f"), ("90 %", ".2f"), ("saturated %", ".0f"))):
                cells = (format(known[d][k] * (100 if k == 2 else 1), form) for d in depths)
                lines.append([f"{name}, {what}", profile, *cells])
    return markdown(["object", "method", *(f"{d:g} mm" for d in depths)], lines)


def _fine(rows: Sequence[FineRow], profiles: Sequence[str], plan: Plan) -> str:
    lines = []
    for question in FINE:
        for profile in profiles:
            sizes = (finest(rows, profile, pitch, question) for pitch in plan.pitches_mm)
            lines.append([question, profile, *("none" if s == float("inf") else f"{s:g}" for s in sizes)])
    return markdown(["what", "method", *(f"pitch {p:g}" for p in plan.pitches_mm)], lines)


def _disturbed(rows: Sequence[DisturbedRow], profiles: Sequence[str]) -> str:
    lines = []
    for what in dict.fromkeys(r.disturbance for r in rows):
        for profile in profiles:
            some = [r for r in rows if r.profile == profile and r.disturbance == what]
            lines.append(
                [
                    what,
                    profile,
                    str(len(some)),
                    f"{100 * np.mean([r.off for r in some]):.1f}",
                    f"{100 * max(r.off for r in some):.0f}",
                    str(sum(not r.valid for r in some)),
                    str(sum(r.valid and bool(r.doubt) for r in some)),
                    str(sum(r.valid and not r.contact for r in some)),
                    str(len(silently_wrong(some))),
                ]
            )
    header = ["what", "method", "frames", "mean %", "worst %", "invalid", "degraded", "lost", "silently > 25 %"]
    return markdown(header, lines)
