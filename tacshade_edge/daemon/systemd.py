"""Messages to the service manager (sd_notify(3), docs/how-to/service.md);
without one, nothing happens here.
"""

from __future__ import annotations

import logging
import os
import socket
import time

from tacshade_edge import libsystemd
from tacshade_edge.pipeline.observer import SourceState
from tacshade_edge.pipeline.pipeline import Grab, Reconstruct
from tacshade_edge.quoting import escaped
from tacshade_edge.reasons import Reason

_log = logging.getLogger(__name__)

STOP_USEC = 10_000_000
"""A stop takes 2 s; a board that is short of CPU time gets this much before it is killed."""

# Timeout for a manager that does not read: the main thread waits meanwhile.
_SEND_S = 1.0


class Service:
    """One daemon's conversation with the service manager."""

    def __init__(self, grab: Grab, reconstruct: Reconstruct) -> None:
        self._grab = grab
        self._reconstruct = reconstruct
        self._stages = self._attempts = 0
        self._note: Reason | None = None

    def tick(self, source: SourceState, fps: float) -> None:
        """Report the published state and the rate of delivered frames;
        feed the watchdog if there was progress.
        """
        reason = f" ({source.reason})" if source.reason else ""
        note = f"; {self._note}" if self._note else ""
        notify(f"STATUS={source.state}{reason}, {fps:.1f} frames/s{note}")
        # Never by a bare timer: a daemon whose frames hang must be started again. One that waits
        # for a camera works as long as it goes on trying.
        if self._progressed(degraded=source.state != "streaming"):
            notify("WATCHDOG=1")

    def reloaded(self, note: Reason | None) -> None:
        """Report that a reload is over; `note` stays in the status until the next."""
        self._note = note
        notify("READY=1", f"STATUS={note or 'reloaded'}")

    def _progressed(self, *, degraded: bool) -> bool:
        """Whether, since the last call, stages of frames have ended; if `degraded`, also attempts
        to get frames. Attempts do not count while a frame hangs.
        """
        # Read before `taken`, so that a frame that comes
        # in between cannot look like a finished one.
        processed, stages, attempts = (
            self._reconstruct.processed,
            self._reconstruct.stages,
            self._grab.attempts,
        )
        hanging = self._reconstruct.taken > processed
        progressed = stages > self._stages or (
            degraded and attempts > self._attempts and not hanging
        )
        self._stages, self._attempts = stages, attempts
        return progressed


def notify_reloading() -> None:
    """Report that a reload begins; ``READY=1`` must follow."""
    notify("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")


def notify_stopping() -> None:
    """Report that a stop begins; from now on the manager's time limit counts,
    not the watchdog's.
    """
    notify("STOPPING=1", f"EXTEND_TIMEOUT_USEC={STOP_USEC}", "STATUS=stopping")


def notify(*lines: str) -> None:
    """Send lines of ``NAME=value`` to the service manager, if there is one:
    by python3-systemd if that is installed.
    """
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    # Escaped: a line end in a reason, which may quote a file, would begin another message.
    message = "\n".join(map(escaped, lines))
    library = libsystemd.module("daemon")
    try:
        if library is None:
            _send(address, message)
        elif libsystemd.has_room(address, _SEND_S):
            # Asked first, as libsystemd waits without limit, and its Python package holds the
            # interpreter's lock while it does, which would stop all threads.
            library.notify(message)
        else:
            raise TimeoutError("timed out")
    except OSError as error:
        _log.warning("cannot notify the service manager: %s", error.strerror or error)


def _send(address: str, message: str) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.settimeout(_SEND_S)
        sender.sendto(message.encode(), libsystemd.path_of(address))
