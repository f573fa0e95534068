#!/usr/bin/env python3
"""Measure what part of each room the quick tests run, and fail if it has fallen.

::

    .venv/bin/python -m tools.ci.measure_coverage [--write]

Python 3.11 counts lines by tracing, with which tests take half as long again: hence a program of
its own, and the quick tests alone. Processes that a test starts count, unless a signal ends them.
``coverage_baseline.json`` has each room's percentage, rounded down; `--write` makes it anew, unless
a room has fallen.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from tools.ci.run_tests import ENVIRONMENT, FEW_EXAMPLES, QUICK, SPREAD, TREE

BASELINE = Path(__file__).with_name("coverage_baseline.json")
FOLDER = TREE / "out" / "coverage"
"""As in pyproject.toml."""
COVERAGE = (sys.executable, "-m", "coverage")
WOBBLE = 1
"""Percent that time and threads decide: a room has fallen if it is further below its baseline."""


def main() -> int:
    """Run the tests, print each room's share, and compare it with the baseline."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help="write the baseline anew")
    args = parser.parse_args()
    report = measured()
    if report is None:
        return 1
    found = by_room(report)
    known = json.loads(BASELINE.read_text(encoding="utf-8"))
    mistakes = fallen(found, known)
    for room, percent in found.items():
        print(f"{room:24} {percent:3} %")
    print(*mistakes, sep="\n", end="\n" if mistakes else "")
    if args.write and not mistakes:
        BASELINE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return int(bool(mistakes))


def measured() -> Mapping[str, tuple[int, int]] | None:
    """Run the quick tests: of each file how many statements ran, of how many; None if some fail."""
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir(parents=True)
    environment = {**os.environ, **ENVIRONMENT, **FEW_EXAMPLES}
    tests = (*COVERAGE, "run", "-m", "pytest", *SPREAD, "-m", QUICK)
    if subprocess.run(tests, cwd=TREE, env=environment, check=False).returncode:
        return None
    report = FOLDER / "report.json"
    for words in (("combine", "--quiet"), ("json", "--quiet", "-o", str(report))):
        subprocess.run((*COVERAGE, *words), cwd=TREE, check=True)
    files = json.loads(report.read_text(encoding="utf-8"))["files"]
    sums = {name: about["summary"] for name, about in files.items()}
    return {name: (sum_["covered_lines"], sum_["num_statements"]) for name, sum_ in sums.items()}


def by_room(files: Mapping[str, tuple[int, int]]) -> dict[str, int]:
    """The percentage of each room's statements that ran, rounded down.

    A room is a folder of the package; what lies beside them belongs to the package.
    """
    rooms: dict[str, tuple[int, int]] = {}
    for name, (ran, statements) in sorted(files.items()):
        room = "/".join(Path(name).parts[:-1][:2])
        ran_before, before = rooms.get(room, (0, 0))
        rooms[room] = (ran_before + ran, before + statements)
    return {room: 100 * ran // max(of, 1) for room, (ran, of) in rooms.items() if of}


def fallen(found: Mapping[str, int], known: Mapping[str, int]) -> list[str]:
    """A line about each room whose share is less than it was; a room may come or go."""
    return [
        f"{room}: the tests run {found[room]} % of it, expected at least {percent - WOBBLE} %"
        for room, percent in known.items()
        if room in found and found[room] < percent - WOBBLE
    ]


if __name__ == "__main__":
    sys.exit(main())
