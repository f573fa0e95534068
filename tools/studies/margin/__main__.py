"""Measure whether the margin announces a slip, and how often it is low while nothing slips.

::

    .venv/bin/python -m tools.studies.margin [--profile NAME] [--held SECONDS] [--final] [--out DIR]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.cli.shared.study import add_cluster
from tacshade_edge.studies.parallel import workers
from tacshade_edge.studies.tables import csv_text
from tools.studies import command
from tools.studies.margin.summary import text
from tools.studies.margin.work import FINAL_GROUPS, GROUPS, HeldRow, LoadRow, Plan, study


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description="The margin before a slip.")
    parser.add_argument("--profile", choices=command.NETWORKS, default="balanced", metavar="NAME")
    parser.add_argument("--held", type=float, default=600.0, metavar="SECONDS", help="over all held in a group (600)")
    parser.add_argument("--final", action="store_true", help="the sensors kept for final figures")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write the table, and its rows as CSV")
    parser.set_defaults(json=False)
    add_cluster(parser)
    args = parser.parse_args(words)
    plan = Plan(args.profile, FINAL_GROUPS if args.final else GROUPS, args.held)
    with command.folder_for(parser, args.out), workers(args.cluster) as pool:
        rows = study(plan, pool, Progress())
        kinds = {"_loads": LoadRow, "_held": HeldRow}
        files = {name: csv_text(kind, [row for row in rows if isinstance(row, kind)]) for name, kind in kinds.items()}
        command.publish(args, "margin", text(rows), files)


if __name__ == "__main__":
    main()
