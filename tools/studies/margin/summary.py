"""Turn the rows into a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tacshade_edge.studies.tables import markdown
from tools.studies.margin.work import HeldRow, LoadRow, Row

AHEAD_S = 0.1
"""Least time in s from an alarm to the onset of the slip that it announces."""


def text(rows: Sequence[Row]) -> str:
    """Write the tables."""
    lines, groups = [], dict.fromkeys(row.group for row in rows)
    for group in groups:
        loads = [row for row in rows if isinstance(row, LoadRow) and row.group == group and not np.isnan(row.onset_s)]
        held = [row for row in rows if isinstance(row, HeldRow) and row.group == group]
        leads = [row.onset_s - row.alarm_s for row in loads if not np.isnan(row.alarm_s)]
        lines.append(
            (
                group,
                str(len(loads)),
                _announced([row.onset_s - row.alarm_s for row in loads]),
                f"{1000 * np.median(leads):.0f}" if leads else "",
                f"{np.median([row.stuck for row in loads if not np.isnan(row.stuck)]):.2f}" if leads else "",
                f"{sum(row.held_s for row in held) / 60:.1f}",
                str(sum(row.alarms for row in held)),
                f"{min((row.least_margin for row in held), default=np.nan):.2f}",
            )
        )
    header = (
        *("sensors and objects", "slips", "announced %", "median lead ms", "still stuck"),
        *("minutes held", "false alarms", "least margin"),
    )
    return markdown(header, lines)


def _announced(leads_s: Sequence[float]) -> str:
    return f"{100 * np.mean([lead >= AHEAD_S - 1e-9 for lead in leads_s]):.0f}" if leads_s else ""
