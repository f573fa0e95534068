"""Runs the tests of this folder inside a guest with a real kernel (tools/rig), one boot for each file.

The tests are ordinary ones, written for the inside: root, Debian's kernel, nothing to lose. On the outside each
file's chosen tests are run by one pytest in the guest, which writes its reports to /out; here they are read back
and take the place of a run. A file with the mark `systemd` gets a guest in which systemd and udev run.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

TREE = Path(__file__).resolve().parents[2]
GUEST = TREE / "tools/rig/guest.py"
LIMIT_S = 300
HANGS_S = 120
"""A test that takes longer tells where it is (all threads' stacks)."""
ATTEMPTS = 2
EXIT_CANNOT, EXIT_UNFINISHED = 77, 125  # of tools/rig/guest.py
_INSIDE = "TACSHADE_GUEST_REPORTS"
_stored = pytest.StashKey[dict[str, list[pytest.TestReport]]]()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test of this folder."""
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            item.add_marker(pytest.mark.guest)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Inside: keep the report for the outside."""
    if _INSIDE in os.environ:
        with Path(os.environ[_INSIDE]).open("a") as file:
            print(json.dumps(report._to_json()), file=file)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> bool | None:
    """Outside: let the reports from the guest stand for the run. (pytest asks every conftest about every item.)"""
    if _INSIDE in os.environ or not item.path.is_relative_to(Path(__file__).parent):
        return None
    stash = item.session.stash
    if _stored not in stash:
        stash[_stored] = {}
    if item.nodeid not in stash[_stored]:
        stash[_stored] |= _run(item)
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for report in stash[_stored][item.nodeid]:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _run(item: pytest.Item) -> dict[str, list[pytest.TestReport]]:
    """Run all chosen tests of the item's file in one guest; a test without its reports is failed or skipped.

    An emulated guest hangs now and then, whatever runs in it: what is left is run in another, once, and it is said.
    """
    left = chosen = [other for other in item.session.items if other.path == item.path]
    results: dict[str, list[pytest.TestReport]] = {}
    for attempt in range(ATTEMPTS):
        done, reports = _boot(item, left)
        results |= {name: found for name, found in reports.items() if found[-1].when == "teardown"}
        left = [other for other in chosen if other.nodeid not in results]
        if done.returncode != EXIT_UNFINISHED or not left:
            break
        terminal = item.config.pluginmanager.get_plugin("terminalreporter")
        terminal.write_line(f"\nguest: attempt {attempt + 1} hung in {left[0].nodeid}\n{_said(done)}")
    skipped = done.returncode == EXIT_CANNOT
    text = done.stderr.strip() if skipped else f"the guest gave no result\n{_said(done)}"
    for other in left:
        path, line, _ = other.location
        reason = (path, line or 0, f"Skipped: {text}") if skipped else text
        outcome = "skipped" if skipped else "failed"
        report = pytest.TestReport(other.nodeid, other.location, {}, outcome, reason, "call")  # type: ignore[arg-type]
        results[other.nodeid] = [report]
    return results


def _boot(
    item: pytest.Item, chosen: list[pytest.Item]
) -> tuple[subprocess.CompletedProcess[str], dict[str, list[pytest.TestReport]]]:
    """One guest: how it ended, and the reports of each test that began."""
    out = TREE / ".rig" / f"out-{item.path.stem}"
    reports = out / "reports.jsonl"
    out.mkdir(parents=True, exist_ok=True)
    reports.unlink(missing_ok=True)
    inside = ["env", f"{_INSIDE}=/out/{reports.name}", sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]
    inside += ["-o", f"faulthandler_timeout={HANGS_S}"]
    systemd = ["--systemd"] if item.get_closest_marker("systemd") else []
    command = [sys.executable, str(GUEST), *systemd, "--out", str(out), "--limit", str(LIMIT_S), *inside]
    done = subprocess.run(
        [*command, *(other.nodeid for other in chosen)], cwd=TREE, text=True, capture_output=True, check=False
    )
    found: dict[str, list[pytest.TestReport]] = {}
    for report in _read(reports):
        found.setdefault(report.nodeid, []).append(report)
    return done, found


def _said(done: subprocess.CompletedProcess[str]) -> str:
    return done.stdout[-4000:] + done.stderr[-4000:]


def _read(path: Path) -> Iterator[pytest.TestReport]:
    if path.exists():
        for line in path.read_text().splitlines():
            yield pytest.TestReport._from_json(json.loads(line))
