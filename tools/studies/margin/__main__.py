"""Whether the margin before a slip announces it, and how often it is low while nothing slips.

::

    .venv/bin/python -m tools.studies.margin [--profile NAME] [--held SECONDS] [--out DIR]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.studies.parallel import usable_cores
from tacshade_edge.studies.tables import csv_text, markdown
from tools.studies import command
from tools.studies.margin.work import HeldRow, LoadRow, Plan, Row, study

AHEAD_S = 0.1
"""A slip is announced when the alarm comes so long before its onset."""


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
                _announced([row.onset_s - row.again_s for row in loads]),
                f"{sum(row.held_s for row in held) / 60:.1f}",
                str(sum(row.alarms for row in held)),
                f"{min((row.least_margin for row in held), default=np.nan):.2f}",
            )
        )
    header = (
        *("sensors and objects", "slips", "announced %", "median lead ms", "still stuck", "again announced %"),
        *("minutes held", "false alarms", "least margin"),
    )
    return markdown(header, lines)


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description="The margin before a slip.")
    parser.add_argument("--profile", choices=command.NETWORKS, default="balanced", metavar="NAME")
    parser.add_argument("--held", type=float, default=600.0, metavar="SECONDS", help="over all held in a group (600)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write the table, and its rows as CSV")
    parser.set_defaults(json=False)
    args = parser.parse_args(words)
    with command.folder_for(parser, args.out):
        rows = study(Plan(args.profile, held_s=args.held), usable_cores(), Progress())
        kinds = {"_loads": LoadRow, "_held": HeldRow}
        files = {name: csv_text(kind, [row for row in rows if isinstance(row, kind)]) for name, kind in kinds.items()}
        command.publish(args, "margin", text(rows), files)


def _announced(leads_s: Sequence[float]) -> str:
    return f"{100 * np.mean([lead >= AHEAD_S - 1e-9 for lead in leads_s]):.0f}" if leads_s else ""


if __name__ == "__main__":
    main()
