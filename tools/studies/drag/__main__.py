"""Objects that are dragged, twisted and tilted.

::

    .venv/bin/python -m tools.studies.drag [--profile NAME...] [--sensors SEED,... | --final] [--objects NAME,...]
        [--references N] [--presses N] [--out DIR]
"""

from __future__ import annotations

from collections.abc import Sequence

from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.studies.parallel import workers
from tacshade_edge.studies.tables import csv_text
from tools.studies import command
from tools.studies.drag.picture import draw
from tools.studies.drag.summary import text
from tools.studies.drag.work import SENSORS, DragRow, Plan, study
from tools.testbed.simulator.families import FINAL_SENSORS

FINAL = tuple(FINAL_SENSORS[k] for k in (0, 1, 3, 4))
"""Two of each family: a dragged frame takes a second."""


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = command.options("Objects that are dragged, twisted and tilted.", SENSORS, FINAL)
    command.add_calibration(parser)
    args = parser.parse_args(words)
    command.check_presses(parser, args.presses)
    plan = Plan(args.sensors, tuple(args.profile), args.objects, args.references, args.presses)
    with command.folder_for(parser, args.out), workers(args.cluster) as pool:
        rows = study(plan, pool, Progress())
        command.publish(args, "drag", text(rows), {"": csv_text(DragRow, rows)}, lambda: {"drag.png": draw(rows)})


if __name__ == "__main__":
    main()
