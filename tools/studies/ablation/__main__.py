"""Show where the error comes from: run one profile with some of its parts made perfect.

::

    .venv/bin/python -m tools.studies.ablation [--profile accurate] [--sensors SEED,... | --final] [--out DIR]
"""

from __future__ import annotations

from collections.abc import Sequence

from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.studies.parallel import workers
from tacshade_edge.studies.tables import csv_text
from tools.studies import command
from tools.studies.ablation.work import AblationRow, Plan, ablate, object_rows, text


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = command.options("Where the error comes from.", "default,5,11,other:31,other:32,other:33")
    parser.set_defaults(profile=["accurate"])
    args = parser.parse_args(words)
    profile, *more = args.profile
    if more or PROFILES[profile].network is None:
        parser.error(f"--profile: found {' '.join((profile, *more))}, expected one that runs a network")
    with command.folder_for(parser, args.out), workers(args.cluster) as pool:
        found = ablate(Plan(args.sensors, profile), pool, Progress())
        command.publish(args, "ablation", text(found), {"": csv_text(AblationRow, object_rows(found))})


if __name__ == "__main__":
    main()
