"""Measure the limits of reconstruction: phantoms, least and greatest depth, finest shape, disturbed frames.

::

    .venv/bin/python -m tools.studies.limits [--profile NAME...] [--sensors SEED,... | --final] [--out DIR]
"""

from __future__ import annotations

from collections.abc import Sequence

from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.studies.parallel import workers
from tacshade_edge.studies.tables import csv_text
from tools.studies import command
from tools.studies.limits import picture
from tools.studies.limits.summary import text
from tools.studies.limits.work import Plan, limits


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = command.options("Where the method ends.", "default,5,11")
    args = parser.parse_args(words)
    plan = Plan(args.sensors, tuple(args.profile))
    with command.folder_for(parser, args.out), workers(args.cluster) as pool:
        found = limits(plan, pool, Progress())
        rows = {f"_{kind}": csv_text(type(some[0]), some) for kind, some in found.tables()}
        command.publish(args, "limits", text(found, plan), rows, lambda: picture.draw(found))


if __name__ == "__main__":
    main()
