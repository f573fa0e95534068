"""How well a hand knows the motion of the object that it holds, from patches whose errors are drawn as measured.

::

    .venv/bin/python -m tools.studies.object_motion [--trials 20] [--rest-s 600] [--csv FILE]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tacshade_edge.studies.tables import csv_text
from tools.studies.object_motion.grasps import Plan, trials
from tools.studies.object_motion.score import MotionRow, score
from tools.studies.object_motion.summary import text


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description="Motion of a held object.")
    parser.add_argument("--trials", type=int, default=20, metavar="N", help="of each object, event, skin and grasp")
    parser.add_argument("--rest-s", type=float, default=600.0, metavar="S")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write a row for each trial")
    args = parser.parse_args(words)
    rows = [score(trial) for trial in trials(Plan(args.trials, rest_s=args.rest_s))]
    print(text(rows))
    if args.csv:
        args.csv.write_text(csv_text(MotionRow, rows), encoding="utf-8")


if __name__ == "__main__":
    main()
