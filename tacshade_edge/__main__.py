"""The entry point of the console script and of ``python -m tacshade_edge``;
it imports nothing slow.
"""

import os
import signal
import sys
from typing import NoReturn

_STREAMS = ("stdin", "stdout", "stderr")


def entry() -> NoReturn:
    """Run the command that the command line names."""
    _open_closed_streams()
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


def _open_closed_streams() -> None:
    """Connect each standard stream that was closed (``0<&- 1>&- 2>&-``) to ``/dev/null``.

    Otherwise the next file or socket would get its number, and with it what a library prints.
    """
    inheritable = True
    for number, name in enumerate(_STREAMS):
        try:
            os.fstat(number)
        except OSError:
            # It gets the lowest free number: this one, since those below it are open by now.
            os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(number, inheritable)
        if getattr(sys, name) is None:
            stream = os.fdopen(number, "w" if number else "r", closefd=False)
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)


if __name__ == "__main__":
    entry()
