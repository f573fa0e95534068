"""Whether the standard deviation of each height holds.

::

    .venv/bin/python -m tools.studies.sigma [--profile NAME...] [--sensors SEED,... | --final] [--objects NAME,...]
        [--references N] [--presses N] [--out DIR]
"""

from __future__ import annotations

from collections.abc import Sequence

from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.studies.parallel import workers
from tacshade_edge.studies.tables import csv_text
from tools.studies import command
from tools.studies.drag.work import SENSORS
from tools.studies.sigma.picture import draw
from tools.studies.sigma.summary import text
from tools.studies.sigma.work import Plan, SigmaRow, study


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = command.options("Whether the standard deviation of each height holds.", SENSORS)
    command.add_calibration(parser)
    args = parser.parse_args(words)
    command.check_presses(parser, args.presses)
    if "paper" in args.profile:
        parser.error("--profile: found paper, which gives no errors")
    plan = Plan(args.sensors, tuple(args.profile), args.objects, args.references, args.presses)
    with command.folder_for(parser, args.out), workers(args.cluster) as pool:
        found = study(plan, pool, Progress())
        rows = {"": csv_text(SigmaRow, [each.row for each in found])}
        command.publish(args, "sigma", text(found), rows, lambda: {"sigma.png": draw(found)})


if __name__ == "__main__":
    main()
