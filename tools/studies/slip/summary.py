"""Turn the rows into figures, and the figures into tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tacshade_edge.studies.tables import markdown
from tools.studies.slip.work import HeldRow, ReleaseRow, Row, SlideRow

WITHIN_S, EARLY_S = 0.1, 0.05
"""Limits in s: a report is in time up to `WITHIN_S` after the onset, and false more than `EARLY_S` before it."""


def is_early(row: SlideRow) -> bool:
    """Whether a slip was reported before the whole contact slid."""
    return row.told_s < row.onset_s - EARLY_S or (np.isnan(row.onset_s) and not np.isnan(row.told_s))


def is_in_time(row: SlideRow) -> bool:
    """Whether a slip was reported within `WITHIN_S` of its onset, but not early."""
    return not is_early(row) and row.told_s <= row.onset_s + WITHIN_S


def text(rows: Sequence[Row]) -> str:
    """Write the tables."""
    slides = [row for row in rows if isinstance(row, SlideRow)]
    held = [row for row in rows if isinstance(row, HeldRow)]
    released = [row for row in rows if isinstance(row, ReleaseRow)]
    parts = (("slide", _slides(slides)), ("are held", _held(held)), ("are lifted off", _released(released)))
    return "\n\n".join(f"Objects that {what}\n\n{table}" for what, table in parts)


def _slides(rows: Sequence[SlideRow]) -> str:
    lines = []
    for profile in dict.fromkeys(row.profile for row in rows):
        for speed in (*dict.fromkeys(row.speed_mm_s for row in rows), None):
            some = [r for r in rows if r.profile == profile and speed in (r.speed_mm_s, None)]
            there = [r for r in some if not np.isnan(r.onset_s)]
            delays = [1000 * (r.told_s - r.onset_s) for r in there if not np.isnan(r.told_s)]
            ratios = [r.found_mm_s / r.true_mm_s for r in there if r.true_mm_s > 0 and not np.isnan(r.found_mm_s)]
            in_time = f"{100 * np.mean([is_in_time(r) for r in there]):.0f}" if there else ""
            lines.append(
                (
                    "all" if speed is None else f"{speed:g} mm/s",
                    profile,
                    str(len(there)),
                    in_time,
                    f"{np.median(delays):.0f}" if delays else "",
                    str(sum(np.isnan(r.told_s) for r in there)),
                    str(sum(map(is_early, some))),
                    f"{np.median(ratios):.2f}" if ratios else "",
                )
            )
    header = ("speed", "method", "slips", "in time %", "median delay ms", "never", "early", "speed found / true")
    return markdown(header, lines)


def _held(rows: Sequence[HeldRow]) -> str:
    lines = []
    for profile in dict.fromkeys(row.profile for row in rows):
        some = [row for row in rows if row.profile == profile]
        minutes = sum(row.held_s for row in some) / 60
        lines.append((profile, f"{minutes:.1f}", str(sum(row.slips for row in some))))
    return markdown(("method", "minutes", "slips told"), lines)


def _released(rows: Sequence[ReleaseRow]) -> str:
    lines = []
    for profile in dict.fromkeys(row.profile for row in rows):
        some = [row for row in rows if row.profile == profile]
        told = [1000 * row.told_s for row in some if not np.isnan(row.told_s)]
        in_time = np.mean([row.told_s <= WITHIN_S for row in some])
        lines.append(
            (
                profile,
                str(len(some)),
                f"{max(row.dent_mm for row in some):.2f}",
                f"{100 * in_time:.0f}",
                f"{max(told, default=np.nan):.0f}",
                str(sum(np.isnan(row.told_s) for row in some)),
                str(sum(row.frames for row in some)),
                str(sum(row.phantoms for row in some)),
            )
        )
    header = ("method", "releases", "deepest dent mm", "in time %", "latest ms", "never", "frames after", "phantoms")
    return markdown(header, lines)
