#!/usr/bin/env python3
"""How often `calibrate` takes right depths for travel from first touch, and travel for that.

::

    .venv/bin/python -m tools.studies.travel [--tables 20000] [--first 0]

The tables have 16 to 40 balls; the network that judges them is off by a factor of 0.7, 1 or 1.4,
and by 0.15 mm. Prints both rates.
"""

from __future__ import annotations

import argparse
from contextlib import suppress

import numpy as np

from support.stated_depths import GEOMETRY, as_travel, right_depths
from tacshade_edge.calibration.indenters import Ball
from tacshade_edge.calibration.presses.table_check import zero_hint
from tacshade_edge.calibration.sentences import FindingError

FACTORS, COUNTS = (0.7, 1.0, 1.4), range(16, 41)


def is_travel(found_mm: list[float], balls: list[Ball]) -> bool:
    """Whether the depths are refused as travel from first touch."""
    with suppress(FindingError):
        zero_hint(found_mm, balls, GEOMETRY)
        return False
    return True


def rates(first: int, tables: int) -> tuple[int, int]:
    """How many of these tables are refused where they are right, and where they state travel."""
    wrongly = rightly = 0
    for number in range(first, first + tables):
        draw = np.random.default_rng((number, 8))
        found_mm, balls = right_depths(int(draw.choice(COUNTS)), number)
        factor = float(draw.choice(FACTORS))
        seen_mm = [factor * each for each in found_mm]
        wrongly += is_travel(seen_mm, balls)
        rightly += is_travel(*as_travel(seen_mm, balls))
    return wrongly, rightly


def main() -> None:
    """Print the rates."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tables", type=int, default=20_000, metavar="N")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="seed of the first table")
    args = parser.parse_args()
    wrongly, rightly = rates(args.first, args.tables)
    print("| depths | tables | taken for travel | in 1000 |\n|---|---:|---:|---:|")
    for name, count in (("right", wrongly), ("travel from first touch", rightly)):
        print(f"| {name} | {args.tables} | {count} | {1000 * count / args.tables:.2f} |")


if __name__ == "__main__":
    main()
