"""The entry point of the console script and of ``python -m tacshade_edge``;
it imports nothing slow.
"""

import os
import signal
import sys
from typing import NoReturn


def entry() -> NoReturn:
    """Run the command that the command line names."""
    if sys.argv[1:2] == ["run"]:
        # The imports take seconds on a small board;
        # until the daemon exists, a stop has nothing to finish.
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: os._exit(0))
        # A daemon's matrices are small, and the supervisor cannot fork with other threads
        # (daemon.supervisor).
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from tacshade_edge.cli import entry as process

    process.entry()


if __name__ == "__main__":
    entry()
