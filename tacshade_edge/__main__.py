"""The process's beginning, of the console script and of ``python -m tacshade_edge``: nothing slow is imported here."""

import os
import signal
import sys
from typing import NoReturn


def entry() -> NoReturn:
    """Do what the command line says."""
    if sys.argv[1:2] == ["run"]:
        # The imports take seconds on a small board; until the daemon is there, a stop has nothing to finish.
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: os._exit(0))
        # A daemon's matrices are small; and with other threads it could not fork (daemon.supervisor).
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from tacshade_edge.cli import entry as process

    process.entry()


if __name__ == "__main__":
    entry()
