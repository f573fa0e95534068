"""Lines of stderr with the priority that journald reads at their start (sd-daemon(3))."""

from __future__ import annotations

import contextlib
import os
import sys
from typing import Final

ERROR: Final = 3
WARNING: Final = 4


def is_journal() -> bool:
    """Whether stderr goes to journald: systemd names the device and inode of its stream."""
    with contextlib.suppress(OSError, ValueError):
        found = os.fstat(sys.stderr.fileno())
        return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"
    return False


def complain(text: str, priority: int = ERROR) -> None:
    """Print lines on stderr, for the journal with a priority: without one they would be notices,
    which `journalctl -p warning` leaves out.
    """
    mark = f"<{priority}>" if is_journal() else ""
    for line in text.split("\n"):
        print(f"{mark}{line}", file=sys.stderr)
    sys.stderr.flush()
