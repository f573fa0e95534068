"""Processes of this machine."""

from __future__ import annotations

import os
from pathlib import Path


def memory_mb(pid: int) -> float:
    """A process's memory now."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and waits for its parent's question does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
