"""Check whether other processes run, and suspend them."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from tools.testbed.patience import wait_until


def is_there(pid: int) -> bool:
    """Whether a process still exists."""
    try:
        return _state(Path(f"/proc/{pid}/stat")) != "Z"
    except FileNotFoundError:
        return False


def suspend(pid: int) -> None:
    """Send SIGSTOP and wait until every thread has stopped.

    The kernel wakes a stopped group that a dying process leaves behind, but only one whose stop is complete: a busy
    thread may take its part in it after the kernel has looked.
    """
    os.kill(pid, signal.SIGSTOP)
    wait_until(lambda: _states(pid) == {"T"}, 20, "each thread stands")


def _states(pid: int) -> set[str]:
    try:
        return {_state(task / "stat") for task in Path(f"/proc/{pid}/task").iterdir()}
    except FileNotFoundError:  # a thread ended meanwhile
        return set()


def _state(path: Path) -> str:
    return path.read_text().rpartition(")")[2].split()[0]
