"""Runs the tests of this folder inside guests with a real kernel (tools/rig): one boot for all of them that need no
more than the kernel, one for those marked `systemd`, in which systemd and udev run. Both at a time.

The tests are ordinary ones, written for the inside: root, Debian's kernel, nothing to lose, everything some twenty
times slower. What only arithmetic can give they are handed (`handed_in`). On the outside one pytest in each guest runs
the chosen tests and writes its reports to /out; here they are read back and take the place of a run. A test that fails
says why before anything is made of it, and one that hangs says where and ends that boot: the tests after it run in
another.
"""

from __future__ import annotations

import faulthandler
import json
import os
import subprocess
import sys
import threading
import traceback
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest

from tools.testbed.patience import patience, slowness_of_all_cores

TREE = Path(__file__).resolve().parents[2]
GUEST = (sys.executable, "-m", "tools.rig.guest")
SILENT_S = 30.0
"""A guest gives a sign of life each second."""
TEST_S = 20.0
"""The longest test takes so long where nothing is emulated."""
CROWDED = 2.0
"""A machine so many times slower boots one guest at a time: neither would keep up with its camera."""
ATTEMPTS = 2
"""The emulator itself hangs now and then, whatever runs in it."""
EXIT_CANNOT, EXIT_UNFINISHED = 77, 125  # of tools/rig/guest.py
_INSIDE = "TACSHADE_GUEST_OUT"
_Reports = dict[str, list[pytest.TestReport]]
_boots = pytest.StashKey[dict[str, Future[_Reports]]]()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test of this folder."""
    for item in items:
        if _is_ours(item):
            item.add_marker(pytest.mark.guest)


def _is_ours(item: pytest.Item) -> bool:
    return item.path.is_relative_to(Path(__file__).parent)  # pytest asks every conftest about every item


# Inside.


def _note(nodeid: str, text: str) -> None:
    with Path(os.environ[_INSIDE], "notes.jsonl").open("a") as file:
        print(json.dumps([nodeid, text]), file=file)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Inside: a test that hangs tells where, and ends this boot."""
    if _INSIDE not in os.environ or not _is_ours(item):
        return (yield)
    _note(item.nodeid, "began\n")
    watch = threading.Timer(patience(TEST_S), _hung)
    watch.daemon = True
    watch.start()
    try:
        return (yield)
    finally:
        watch.cancel()


def _hung() -> None:
    """Where each thread is, which processes there are, and where the kernel holds those that it holds."""
    with Path(os.environ[_INSIDE], "hang.txt").open("w") as file:
        faulthandler.dump_traceback(file)
        file.flush()
        look = "ps axo pid,ppid,stat,wchan:32,args; echo w >/proc/sysrq-trigger; dmesg | tail -n 200"
        subprocess.run(look, shell=True, stdout=file, check=False)
    os._exit(1)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[pytest.TestReport]:
    """Inside: note a failure before pytest makes much of it, which may take minutes."""
    if _INSIDE in os.environ and call.excinfo is not None:
        _note(item.nodeid, "".join(traceback.format_exception(call.excinfo.value, limit=-4)))
    return (yield)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Inside: keep the report for the outside."""
    if _INSIDE in os.environ:
        with Path(os.environ[_INSIDE], "reports.jsonl").open("a") as file:
            print(json.dumps(report._to_json()), file=file)


# Outside.


@dataclass(frozen=True)
class _Boot:
    """How one guest ended.

    Attributes
    ----------
    exit_code : int
        Of guest.py.
    output : str
    reports : dict
        Of the tests that are done.
    notes : dict of str to str
        What was noted of each test that began.
    stacks : str
        Where the test was that hung; empty when none did.
    """

    exit_code: int
    output: str
    reports: _Reports
    notes: dict[str, str]
    stacks: str


@pytest.hookimpl(specname="pytest_runtest_protocol", tryfirst=True)
def pytest_runtest_protocol_outside(item: pytest.Item) -> bool | None:
    """Outside: let the reports from the guest stand for the run."""
    if _INSIDE in os.environ or not _is_ours(item):
        return None
    stash = item.session.stash
    if _boots not in stash:
        stash[_boots] = _start(item.session)
    reports = stash[_boots][_kind(item)].result()[item.nodeid]
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _kind(item: pytest.Item) -> str:
    return "systemd" if item.get_closest_marker("systemd") else "kernel"


def _start(session: pytest.Session) -> dict[str, Future[_Reports]]:
    """Boot a guest for each kind of the chosen tests."""
    kinds: dict[str, list[pytest.Item]] = {}
    for item in filter(_is_ours, session.items):
        kinds.setdefault(_kind(item), []).append(item)
    command = [sys.executable, "-m", "support.make_handed_in"]
    made = subprocess.run(command, cwd=TREE / "tests", stdout=subprocess.DEVNULL, check=False)
    assert made.returncode == 0, "what the guests are handed could not be made"
    pool = ThreadPoolExecutor(len(kinds) if slowness_of_all_cores() < CROWDED else 1)
    boots = {kind: pool.submit(_run, kind, items) for kind, items in kinds.items()}
    pool.shutdown(wait=False)
    return boots


def _run(kind: str, items: list[pytest.Item]) -> _Reports:
    """Run tests until each has a result: in one guest, in others after those that hung."""
    out = TREE / ".rig" / f"out-{kind}"
    out.mkdir(parents=True, exist_ok=True)
    results: _Reports = {}
    attempts = 0
    while left := [item for item in items if item.nodeid not in results]:
        boot = _boot(kind, out, left)
        results |= boot.reports
        unfinished = [item for item in left if item.nodeid not in results]
        began = [item for item in unfinished if item.nodeid in boot.notes]
        if boot.exit_code == EXIT_CANNOT:
            results |= {item.nodeid: [_skipped(item, boot.output.strip())] for item in unfinished}
        elif boot.stacks and began:
            where = f"hung; its threads:\n{boot.stacks}\n{boot.notes[began[0].nodeid]}"
            results[began[0].nodeid] = [_failed(began[0], where)]
        elif unfinished:
            attempts += 1
            print(
                f"\nguest: attempt {attempts} ended without a result of {unfinished[0].nodeid}\n{boot.output[-2000:]}"
            )
            if attempts == ATTEMPTS:
                why = f"the guest gave no result\n{boot.output[-4000:]}"
                results |= {i.nodeid: [_failed(i, f"{why}\n{boot.notes.get(i.nodeid, '')}")] for i in unfinished}
    return results


def _boot(kind: str, out: Path, chosen: list[pytest.Item]) -> _Boot:
    names = {name: out / name for name in ("reports.jsonl", "notes.jsonl", "hang.txt")}
    for path in names.values():
        path.unlink(missing_ok=True)
    guest = [*GUEST, "--out", str(out), "--silent", f"{patience(SILENT_S):.0f}"]
    guest += ["--systemd"] if kind == "systemd" else []
    check = subprocess.run([*guest, "--check"], text=True, capture_output=True, check=False)
    if check.returncode:
        return _Boot(check.returncode, check.stderr, {}, {}, "")
    stops = os.environ.get("TACSHADE_STOPS", "1")
    inside = [
        "env",
        f"{_INSIDE}=/out",
        f"TACSHADE_STOPS={stops}",
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:faulthandler",
        "-p",
        "no:hypothesispytest",
        f"--confcutdir={Path(__file__).parent}",  # without hypothesis, whose import takes half a minute there
    ]
    command = [*guest, *inside, *(item.nodeid for item in chosen)]
    done = subprocess.run(command, cwd=TREE, text=True, capture_output=True, check=False)
    reports: _Reports = {}
    for line in _lines(names["reports.jsonl"]):
        report = pytest.TestReport._from_json(json.loads(line))
        if report.skipped:  # pytest wants a tuple, which JSON has not
            report.longrepr = tuple(report.longrepr)  # type: ignore[arg-type]
        reports.setdefault(report.nodeid, []).append(report)
    notes: dict[str, str] = {}
    for nodeid, text in map(json.loads, _lines(names["notes.jsonl"])):
        notes[nodeid] = notes.get(nodeid, "") + text
    return _Boot(
        exit_code=done.returncode,
        output=done.stdout + done.stderr,
        reports={nodeid: found for nodeid, found in reports.items() if found[-1].when == "teardown"},
        notes=notes,
        stacks="\n".join(_lines(names["hang.txt"])),
    )


def _lines(path: Path) -> list[str]:
    return path.read_text(errors="replace").splitlines() if path.exists() else []


def _skipped(item: pytest.Item, why: str) -> pytest.TestReport:
    path, line, _ = item.location
    reason = (path, line or 0, f"Skipped: {why}")
    return pytest.TestReport(item.nodeid, item.location, {}, "skipped", reason, "call")


def _failed(item: pytest.Item, why: str) -> pytest.TestReport:
    return pytest.TestReport(item.nodeid, item.location, {}, "failed", why, "call")
