#!/usr/bin/env python3
"""Run every stage of the tests in order, and report at the end what each ran,
skipped (and why) and took.

::

    python3 -m tools.ci.run_tests [STAGE... | TEST]

`make test` runs lint, tests and guest, `make check` lint and quick: the tests without a mark. A
stage that fails does not keep the next from running. Exit 1 when one failed. A TEST (a file, a
folder or FILE::NAME) runs alone, in the guest if it belongs there.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

TREE = Path(__file__).resolve().parents[2]
PYTEST = (sys.executable, "-m", "pytest")
WORKERS = str((os.cpu_count() or 1) + 1)
"""One more than there are cores: every third test waits, for a broker, a second, a page.

With two per core they are hardly faster (743 s, not 760), and those that read a clock may fail.
"""
SPREAD = ("-n", WORKERS, "--dist", "worksteal")
"""A worker has neighbouring tests, which share what a module makes,
until it has nothing left to do.
"""
QUICK = "not (broker or browser or container or fit or guest or node or slow)"
WITH_BROKER = "broker and not (browser or container or fit or guest or node)"
ALL = "not guest and not container"
ENVIRONMENT = {
    name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"
}
"""Tests are compiled once, not by each worker of each stage: 11 s of a core."""
ENVIRONMENT |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENCV_FOR_THREADS_NUM": "1"}
"""As the program sets it for itself.

Threads of several workers wait for each other at full speed: to learn from labels took 24 s of
processor time with them and takes 8 s without.
"""
FEW_EXAMPLES = {"CI": "1"}
"""Of each property, the same in every run."""
BESIDE = ("lint",)
"""Run beside the rest, whose tests wait now and then; each shows its output when it is over.

With the guest beside them all took 633 and 705 s on two cores,
but tests that a clock hurries failed, of both stages.
"""
STAGES: dict[str, tuple[str, ...]] = {
    "lint": ("make", "--no-print-directory", "lint"),
    "quick": (*PYTEST, *SPREAD, "-m", QUICK, "--durations=5", "--durations-min=0.5"),
    "broker": (*PYTEST, *SPREAD, "-m", WITH_BROKER, "--durations=5", "--durations-min=5"),
    "tests": (*PYTEST, *SPREAD, "-m", ALL, "--durations=20", "--durations-min=5"),
    "guest": (sys.executable, "-m", "tools.ci.run_guest"),
}
"""The tests of `quick` and `broker` are among the `tests`: each worker imports 400 files once."""
EVERYTHING = ("lint", "tests", "guest")
GUESTS_RESULTS = TREE / ".rig/out/results.xml"
CANNOT = 77
"""The guest's exit status where it lacks something."""


@dataclass(frozen=True)
class Stage:
    """A stage's result; the counts are 0 if it runs no tests."""

    name: str
    seconds: float
    ok: bool
    passed: int
    failed: int
    skipped: Counter[str]


def run(name: str) -> Stage:
    """Run a stage and show its output as it comes, or for those in `BESIDE` at the end."""
    print(f"--- {name}", flush=True)
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        results = GUESTS_RESULTS if name == "guest" else Path(folder, "results.xml")
        words = STAGES[name]
        if words[: len(PYTEST)] == PYTEST:
            words = (*words, f"--junitxml={results}")
        beside = name in BESIDE
        environment = ENVIRONMENT | (FEW_EXAMPLES if name == "quick" else {})
        done = subprocess.run(
            words, cwd=TREE, env=environment, text=True, capture_output=beside, check=False
        )
        if beside:
            print(f"--- {name} ended\n{done.stdout}{done.stderr}", flush=True)
        cases = list(ElementTree.parse(results).iter("testcase")) if results.exists() else []
    bad = sum(case.find("failure") is not None or case.find("error") is not None for case in cases)
    skips = [found for case in cases if (found := case.find("skipped")) is not None]
    skipped = Counter(
        found.get("message", "") for found in skips if found.get("type") != "pytest.xfail"
    )
    cannot = name == "guest" and done.returncode == CANNOT
    if cannot:
        skipped[done.stderr.strip()] += 1
    passed = len(cases) - bad - len(skips)
    return Stage(
        name, time.monotonic() - began_s, done.returncode == 0 or cannot, passed, bad, skipped
    )


def run_one(test: str) -> int:
    """Run one file, folder or test and show its output; pytest's exit status."""
    in_guest = Path(test.partition("::")[0]).is_relative_to("tests/guest")
    words = STAGES["guest"] if in_guest else (*PYTEST, "-rs")
    return subprocess.run((*words, test), cwd=TREE, env=ENVIRONMENT, check=False).returncode


def main() -> int:
    """Run the named stages, one test, or all stages."""
    if sys.argv[1:] and sys.argv[1] not in STAGES:
        return run_one(sys.argv[1])
    began_s = time.monotonic()
    names = sys.argv[1:] or list(EVERYTHING)
    with ThreadPoolExecutor(max_workers=1) as pool:
        beside = [pool.submit(run, name) for name in names if name in BESIDE]
        stages = [run(name) for name in names if name not in BESIDE]
        stages += [future.result() for future in beside]
    print("\nstage       s   passed  failed  skipped")
    for stage in stages:
        counts = f"{stage.passed:8} {stage.failed:7} {stage.skipped.total():8}"
        print(f"{stage.name:7}{stage.seconds:6.0f} {counts}{'' if stage.ok else '   FAILED'}")
        for why, count in stage.skipped.items():
            print(f"       {count} skipped: {why}")
    print(f"all    {time.monotonic() - began_s:6.0f}")
    total = [sum(stage.passed for stage in stages), sum(stage.failed for stage in stages)]
    print(
        f"{total[0]} passed, {total[1]} failed, "
        f"{sum(stage.skipped.total() for stage in stages)} skipped"
    )
    return 0 if all(stage.ok for stage in stages) else 1


if __name__ == "__main__":
    sys.exit(main())
