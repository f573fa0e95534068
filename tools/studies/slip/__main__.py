"""Measure how soon slips and releases are reported, and how often falsely.

::

    .venv/bin/python -m tools.studies.slip [--profile NAME...] [--sensors SEED,... | --final] [--out DIR]
"""

from __future__ import annotations

from collections.abc import Sequence

from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.studies.parallel import workers
from tacshade_edge.studies.tables import csv_text
from tools.studies import command
from tools.studies.slip.summary import text
from tools.studies.slip.work import HeldRow, Plan, ReleaseRow, SlideRow, study
from tools.testbed.simulator.families import FINAL_SENSORS

KINDS = {"_slides": SlideRow, "_held": HeldRow, "_releases": ReleaseRow}


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = command.options("Slips and releases over time.", "default,5,11", FINAL_SENSORS[:3])
    args = parser.parse_args(words)
    if any(sensor.family != "tacshade" for sensor in args.sensors):
        parser.error("--sensors: only the family tacshade moves in time")
    with command.folder_for(parser, args.out), workers(args.cluster) as pool:
        rows = study(Plan(args.sensors, tuple(args.profile)), pool, Progress())
        files = {name: csv_text(kind, [row for row in rows if isinstance(row, kind)]) for name, kind in KINDS.items()}
        command.publish(args, "slip", text(rows), files)


if __name__ == "__main__":
    main()
