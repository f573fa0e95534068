"""Measure how well a hand knows the motion of the object that it holds.

::

    .venv/bin/python -m tools.studies.object_motion [--trials 20] [--rest-s 600] [--csv FILE]
    .venv/bin/python -m tools.studies.object_motion --drawn 3 [--final] [--csv FILE] [--cluster tcp://HOST:8786]

The first command draws the errors of patches as measured before. In the second, a simulated hand holds an object, and
the study draws and reconstructs the pictures of all five fingers, which takes a minute of one core per trial.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tacshade_edge.cli.shared import study
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.studies.parallel import workers
from tacshade_edge.studies.tables import csv_text
from tools.studies import command
from tools.studies.object_motion import drawn
from tools.studies.object_motion.grasps import Plan, trials
from tools.studies.object_motion.score import MotionRow, score
from tools.studies.object_motion.summary import text


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description="Motion of a held object.")
    parser.add_argument("--trials", type=int, default=20, metavar="N", help="of each object, event, skin and grasp")
    parser.add_argument("--rest-s", type=float, default=600.0, metavar="S")
    parser.add_argument("--drawn", type=int, metavar="N", help="pictures instead, so many of each object and family")
    parser.add_argument("--final", action="store_true", help="with --drawn: the sensors kept for final figures")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write a row for each trial")
    study.add_cluster(parser)
    args = parser.parse_args(words)
    if args.drawn:
        families = drawn.FINAL_FAMILIES if args.final else drawn.FAMILIES
        with command.folder_for(parser, None), workers(args.cluster) as pool:
            rows = drawn.rows(args.drawn, pool, Progress(), families)
    else:
        rows = [score(trial) for trial in trials(Plan(args.trials, rest_s=args.rest_s))]
    print(text(rows))
    if args.csv:
        args.csv.write_text(csv_text(MotionRow, rows), encoding="utf-8")


if __name__ == "__main__":
    main()
