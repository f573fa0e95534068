"""Format a board's figures as a Markdown block to send in; its table is a row of docs/reference/boards.md."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from tacshade_edge.studies.tradeoff.summary import Point

PROFILES = ("fast", "balanced", "accurate")
HEADER = ("board", "processor", "system", "version", *PROFILES, "untouched", "MiB", "busy")


def block(facts: Mapping[str, str], points: Sequence[Point], busy: float) -> str:
    """The Markdown block of a board.

    Parameters
    ----------
    facts : mapping
        Facts about the board (`doctor.board_facts`): each is a line, and the table shows `board`, `processor`,
        `cores`, `system` and `tacshade-edge`.
    points : sequence of Point
        Points of the shipped profiles.
    busy : float
        Elapsed time over this command's processor time; 1 on an idle machine.
    """
    beside = [f"- {name}: {text}" for name, text in facts.items()]
    rule = "|".join(["---"] * len(HEADER))
    table = [f"| {' | '.join(HEADER)} |", f"|{rule}|", row(facts, points, busy)]
    return "\n".join([*table, "", *beside, ""])


def row(facts: Mapping[str, str], points: Sequence[Point], busy: float) -> str:
    """The board as a row under `HEADER`."""
    found = {point.setting.profile.name: point for point in points if point.setting.shipped}
    times = [_times(found.get(name)) for name in PROFILES]
    cores = facts["cores"].partition(",")[0]
    processor = f"{facts.get('processor', 'unknown')}, {cores} cores"
    some = [found[name] for name in PROFILES if name in found]
    quiet = [point.idle_p50_ms for point in some if not math.isnan(point.idle_p50_ms)]
    cells = [facts["board"], processor, facts.get("system", "unknown"), facts["tacshade-edge"], *times]
    cells.append(f"{min(quiet):.2f} to {max(quiet):.2f}" if quiet else "")
    cells.append(f"{max(point.peak_mib for point in some):.0f}" if some else "")
    return f"| {' | '.join([*cells, f'{busy:.1f}'])} |"


def _times(point: Point | None) -> str:
    return "" if point is None or not point.timed else f"{point.p50_ms.value:.2f} / {point.p99_ms.value:.2f}"
