"""The tables of the study of limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from tacshade_edge.lab.studies.markdown import grouped, markdown, summary
from tools.studies.disturbances import BEYOND
from tools.studies.limit_rows import (
    DeepRow,
    DepthRow,
    DisturbedRow,
    FaintRow,
    FineRow,
    Found,
    NullRow,
)

_Row = TypeVar("_Row", bound=Found)
DETECTED = 0.95
"""Share of presses that must be found for a depth to count as detected."""
RESOLVED = 0.75
"""Share of places at which a gap or ridge must be resolved."""
DIP_PART, LEAST_DIP_MM, RIDGE_OFF = 0.5, 0.05, 0.2
"""A gap is resolved if h dips by at least half of the true dip,
and a ridge if its height is within a fifth.
"""
BARS = 2
FINE: dict[str, tuple[str, Callable[[FineRow], bool]]] = {
    "gap: two objects": ("bars", lambda row: row.objects == BARS),
    "gap: half the dip": (
        "bars",
        lambda row: row.found_height_mm >= max(DIP_PART * row.true_height_mm, LEAST_DIP_MM),
    ),
    "ridge: height within 20 %": (
        "ridge",
        lambda r: abs(r.found_height_mm / r.true_height_mm - 1) <= RIDGE_OFF,
    ),
}
"""The questions about fine shapes, with the shape and the test of each."""


def detected(some: Sequence[DepthRow]) -> dict[float, float]:
    """Share of presses found by depth."""
    return {
        depth: float(np.mean([r.contact for r in of]))
        for depth, of in sorted(grouped(some, "depth_mm").items())
    }


def depth_errors(some: Sequence[DepthRow]) -> dict[float, tuple[float, float, float]]:
    """By depth: mean absolute error, its 90th percentile in mm, share reported as saturated."""
    made = {}
    for depth, here in sorted(grouped(some, "depth_mm").items()):
        off = np.abs([r.found_mm - r.true_mm for r in here])
        made[depth] = (
            float(off.mean()),
            float(np.quantile(off, 0.9)),
            float(np.mean([r.saturated for r in here])),
        )
    return made


def finest(rows: Sequence[FineRow], pitch_mm: float, question: str) -> float:
    """Find the size at and above which a shape is resolved at `RESOLVED` of the places;
    infinity if there is none.
    """
    shape, came_out = FINE[question]
    least = math.inf
    sizes = grouped((r for r in rows if r.pitch_mm == pitch_mm and r.shape == shape), "size_mm")
    for size, some in sorted(sizes.items(), reverse=True):
        if np.mean([came_out(r) for r in some]) < RESOLVED:
            break
        least = size
    return least


def by_profile(rows: Iterable[Found], kind: type[_Row]) -> dict[str, list[_Row]]:
    """The rows of a kind by profile."""
    return grouped((row for row in rows if isinstance(row, kind)), "profile")


NULLS: dict[str, Callable[[Sequence[NullRow]], str]] = {
    "frames": lambda some: str(len(some)),
    "invalid": lambda some: str(sum(not r.valid for r in some)),
    "degraded": lambda some: str(sum(r.valid and bool(r.doubt) for r in some)),
    "phantoms": lambda some: str(sum(r.contact for r in some)),
    "silent ones": lambda some: str(sum(r.contact and not r.doubt for r in some)),
    "deepest mm": lambda some: f"{max(r.found_mm for r in some):.2f}",
}
DISTURBED: dict[str, Callable[[Sequence[DisturbedRow]], str]] = {
    "frames": lambda some: str(len(some)),
    "mean %": lambda some: f"{100 * np.mean([r.off for r in some]):.1f}",
    "worst %": lambda some: f"{100 * max(r.off for r in some):.0f}",
    "invalid": lambda some: str(sum(not r.valid for r in some)),
    "degraded": lambda some: str(sum(r.valid and bool(r.doubt) for r in some)),
    "lost": lambda some: str(sum(r.valid and not r.contact for r in some)),
    "silently > 25 %": lambda some: str(sum(r.silently_wrong for r in some)),
}


def text(rows: Sequence[Found]) -> str:
    """The tables, for a terminal and a document."""
    parts: tuple[tuple[str, Callable[[Any], str], type[Any]], ...] = (
        ("Nothing touches", _nulls_table, NullRow),
        ("The least depth: part of the presses that is found, %", _faint_table, FaintRow),
        ("The greatest depth: error of the greatest h, mm", _deep_table, DeepRow),
        ("The finest shape, mm", _fine_table, FineRow),
        ("A contact of 2 mm, disturbed: change of its depth, %", _disturbed_table, DisturbedRow),
    )
    of_kinds = ((title, table, by_profile(rows, kind)) for title, table, kind in parts)
    return "\n\n".join(f"{title}\n\n{table(some)}" for title, table, some in of_kinds if some)


def _nulls_table(profiles: Mapping[str, Sequence[NullRow]]) -> str:
    kinds = list(dict.fromkeys(row.disturbance for rows in profiles.values() for row in rows))
    within = [kind for kind in kinds if kind not in BEYOND]
    parts = {**{kind: [kind] for kind in within}, "all of these": within}
    parts |= {f"beyond: {kind}": [kind] for kind in kinds if kind in BEYOND}
    groups = [
        ((title, profile), [row for row in rows if row.disturbance in part])
        for title, part in parts.items()
        for profile, rows in profiles.items()
    ]
    return summary(("what", "method"), groups, NULLS)


def _faint_table(profiles: Mapping[str, Sequence[FaintRow]]) -> str:
    lines, depths = (
        [],
        dict.fromkeys(depth for rows in profiles.values() for depth in detected(rows)),
    )
    for radius in sorted({row.radius_mm for rows in profiles.values() for row in rows}):
        for profile, rows in profiles.items():
            parts = detected([row for row in rows if row.radius_mm == radius]).values()
            lines.append(
                [f"ball, radius {radius:g} mm", profile, *(f"{100 * part:.0f}" for part in parts)]
            )
    return markdown(["object", "method", *(f"{depth:g} mm" for depth in depths)], lines)


def _deep_table(profiles: Mapping[str, Sequence[DeepRow]]) -> str:
    lines: list[list[str]] = []
    for name in dict.fromkeys(row.object for rows in profiles.values() for row in rows):
        for profile, rows in profiles.items():
            known = depth_errors([row for row in rows if row.object == name])
            whole = [known[depth] for depth in known if depth == round(depth)]
            lines.append([f"{name}, mean", profile, *(f"{mean:.2f}" for mean, _, _ in whole)])
            lines.append([f"{name}, 90 %", profile, *(f"{high:.2f}" for _, high, _ in whole)])
            lines.append(
                [
                    f"{name}, saturated %",
                    profile,
                    *(f"{100 * saturated:.0f}" for *_, saturated in whole),
                ]
            )
    depths = dict.fromkeys(
        depth for rows in profiles.values() for depth in depth_errors(rows) if depth == round(depth)
    )
    return markdown(["object", "method", *(f"{depth:g} mm" for depth in depths)], lines)


def _fine_table(profiles: Mapping[str, Sequence[FineRow]]) -> str:
    pitches = dict.fromkeys(row.pitch_mm for rows in profiles.values() for row in rows)
    lines = []
    for question in FINE:
        for profile, rows in profiles.items():
            sizes = (finest(rows, pitch, question) for pitch in pitches)
            lines.append(
                [
                    question,
                    profile,
                    *("none" if size == math.inf else f"{size:g}" for size in sizes),
                ]
            )
    return markdown(["what", "method", *(f"pitch {pitch:g}" for pitch in pitches)], lines)


def _disturbed_table(profiles: Mapping[str, Sequence[DisturbedRow]]) -> str:
    kinds = dict.fromkeys(row.disturbance for rows in profiles.values() for row in rows)
    groups = [
        ((what, profile), [row for row in rows if row.disturbance == what])
        for what in kinds
        for profile, rows in profiles.items()
    ]
    return summary(("what", "method"), groups, DISTURBED)
