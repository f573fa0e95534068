"""The dashboard as its users run it: a child process that prints its address
and must stop cleanly.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from support.patience import patience


@contextmanager
def dashboard(broker: str, *words: str) -> Iterator[str]:
    """Run it on a free port for a broker at HOST:PORT; yield the page's address."""
    command = [
        sys.executable,
        "-m",
        "tacshade_edge",
        "dashboard",
        "--broker",
        broker,
        "--http",
        "0",
        *words,
    ]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None
        line = child.stdout.readline()
        found = re.search(r"https?://\S+", line)
        assert found, line
        yield found[0]
        child.send_signal(signal.SIGTERM)
        assert child.wait(patience(10)) == 0
    finally:
        child.kill()
        child.communicate()
