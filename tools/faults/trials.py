"""The trials of the test suite that break something on purpose, run alone and counted.

A test that tries many kinds in a loop states their number with ``record_property("tried", N)``; any
other tries one.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

TREE = Path(__file__).resolve().parents[2]
WORKERS = 2
ENVIRONMENT = {"CI": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""The examples of each property are few and always the same."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One row of the table: what is tried, and the tests that do it (files, or ``FILE::NAME``)."""

    what: str
    tests: tuple[str, ...]


_CLIENTS = ("tests/dashboard/test_downloads.py", "tests/test_slow_readers.py")
_BROKER = "tests/mqtt/test_hostile_broker.py"
_SERIAL = "tests/robot/test_serial_link.py"
_CLOCK = "tests/robot/test_clock_sync.py"
_LINE = "tests/robot/test_line.py"

TRIALS = (
    Trial(
        "a long command gets a bad input, or an output that cannot be written or is another's",
        ("tests/cli/test_long_commands.py",),
    ),
    Trial(
        "two processes write one file, or one of them is killed", ("tests/files/test_targets.py",)
    ),
    Trial(
        "a file of ours is given where another kind is expected", ("tests/cli/test_wrong_files.py",)
    ),
    Trial(
        "a fit cannot write, is killed, or loses a worker",
        ("tests/cli/test_fit_option.py", "tests/cli/commands/test_calibrate_ends.py"),
    ),
    Trial(
        "a system call that writes a kept file fails, writes half, or finds the disk full",
        ("tests/files/test_failing_disk.py",),
    ),
    Trial(
        "the power is cut at a sync of a kept file, or while a recording's table is written",
        ("tests/files/test_power_cuts.py", "tests/recording/test_power_cut.py"),
    ),
    Trial(
        "a stored number is impossible, behind a right checksum",
        ("tests/calibration/files/test_impossible_values.py",),
    ),
    Trial(
        "numbers at their ends: skins, pictures, times, tables, descriptions, settings, messages",
        (
            "tests/sensor/test_sizes.py",
            "tests/files/test_extreme_numbers.py",
            "tests/wire/test_binary.py",
        ),
    ),
    Trial(
        "SIGTERM comes at any moment of a start; standard streams are closed",
        (
            "tests/cli/commands/test_run.py::test_a_stop_at_any_moment_of_a_start_is_a_stop",
            "tests/cli/commands/test_run.py::test_closed_standard_streams_are_no_failure",
        ),
    ),
    Trial(
        "threads, descriptors, files, locks and subscriptions, before and after twenty times",
        ("tests/test_leaks.py",),
    ),
    Trial("clients read a byte at a time, stall, or come and go a hundred times", _CLIENTS),
    Trial(
        "SIGTERM and SIGKILL come beside an open page and a running download",
        ("tests/dashboard/test_ends.py",),
    ),
    Trial("a broker's packets are cut at every byte, out of order, hostile or denied", (_BROKER,)),
    Trial(
        "a robot answers late, twice, in another order, damaged, or never",
        (_SERIAL, _CLOCK, _LINE),
    ),
)


@dataclass(slots=True)
class Counted:
    """What a trial's tests did."""

    tests: int = 0
    tried: int = 0
    failed: int = 0
    skipped: int = 0
    seconds: float = 0.0


def count(trials: Iterable[Trial], results: ElementTree.Element) -> dict[str, Counted]:
    """Sum pytest's results (JUnit's XML) by trial."""
    found = {trial.what: Counted() for trial in trials}
    trial_of = {test.partition(".py")[0]: trial.what for trial in trials for test in trial.tests}
    for case in results.iter("testcase"):
        of = found[trial_of[case.get("classname", "").replace(".", "/")]]
        of.seconds += float(case.get("time", 0))
        if case.find("skipped") is not None:
            of.skipped += 1
            continue
        of.tests += 1
        of.failed += case.find("failure") is not None or case.find("error") is not None
        stated = [each.get("value", "1") for each in case.iter("property")]
        of.tried += int(stated[0]) if stated else 1
    return found


def run(words: list[str] | None) -> tuple[str, list[str]]:
    """Run the trials whose rows have one of the words; return a table and the problems."""
    trials = [trial for trial in TRIALS if not words or any(word in trial.what for word in words)]
    tests = [test for trial in trials for test in trial.tests]
    began_s, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "results.xml")
        command = [sys.executable, "-m", "pytest", "-n", str(WORKERS), f"--junitxml={file}", *tests]
        environment = os.environ | ENVIRONMENT
        done = subprocess.run(
            command, cwd=TREE, env=environment, stdout=subprocess.PIPE, text=True, check=False
        )
        if not file.exists():
            return "", [f"the tests did not run: {done.stdout[-2000:]}"]
        found = count(trials, ElementTree.parse(file).getroot())
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    worked_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    wall_s = time.monotonic() - began_s
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    end = f"\n\nIn {wall_s:.0f} s, with {worked_s:.0f} s of processor time."
    return table(found) + end, failed


def table(found: dict[str, Counted]) -> str:
    """Write the table."""
    lines = ["| trial | tests | tried | failed | not run | s |", "|---|---:|---:|---:|---:|---:|"]
    lines += [
        f"| {what} | {of.tests} | {of.tried} | {of.failed} | {of.skipped} | {of.seconds:.0f} |"
        for what, of in found.items()
    ]
    return "\n".join(lines)
