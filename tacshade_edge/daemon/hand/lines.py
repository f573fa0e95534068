"""The lines from the fingers' processes to the hand's process, made before any of them is forked.

Each finger has its own pair of datagram sockets: a finger that fills its line harms no other, what comes out of a line
is that finger's, and neither end waits. One byte of shared memory holds what the hand wants.
"""

from __future__ import annotations

import contextlib
import mmap
import socket
from collections.abc import Sequence

from tacshade_edge.protocol.hand import Finger, away, decode_finger, encode_finger
from tacshade_edge.reasons import Reason, ReasonCode

BYTES_MAX = 1 << 15


class FingerLine:
    """A finger's end. If no hand's process reads it, the kernel takes some hundred messages and then no more."""

    def __init__(self, sock: socket.socket, wanted: mmap.mmap) -> None:
        self._sock = sock
        self._wanted = wanted

    @property
    def wanted(self) -> bool:
        """Whether somebody listens to the hand."""
        return self._wanted[0] != 0

    def report(self, finger: Finger) -> None:
        """Send a report, or drop it if there is no room; the next comes soon."""
        with contextlib.suppress(OSError):
            self._sock.send(encode_finger(finger))

    def close(self) -> None:
        """Close this end."""
        self._sock.close()


class HandLine:
    """The hand's end of one finger's line."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock

    def fileno(self) -> int:
        """The file descriptor, for a selector."""
        return self._sock.fileno()

    def close(self) -> None:
        """Close this end."""
        self._sock.close()

    def take(self) -> Finger | None:
        """The oldest report that waits; None if none does. Raises DecodeError."""
        try:
            return decode_finger(self._sock.recv(BYTES_MAX))
        except BlockingIOError:
            return None


class Lines:
    """All lines of a hand.

    Parameters
    ----------
    names : sequence of str
        The fingers' ids.

    Attributes
    ----------
    fingers : dict of str to FingerLine
    hand : dict of str to HandLine
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._wanted = mmap.mmap(-1, 1)
        self.fingers: dict[str, FingerLine] = {}
        self.hand: dict[str, HandLine] = {}
        for name in names:
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            ours.setblocking(False)
            theirs.setblocking(False)
            self.hand[name], self.fingers[name] = HandLine(ours), FingerLine(theirs, self._wanted)

    def end(self, name: str) -> None:
        """Report for a finger that its process has ended."""
        if name in self.fingers:
            self.fingers[name].report(away(Reason(ReasonCode.DAEMON_STOPPED, "the sensor's process has ended")))

    def close(self) -> None:
        """Close this process's ends."""
        for name, finger in self.fingers.items():
            finger.close()
            self.hand[name].close()

    def want(self, wanted: bool) -> None:
        """Notify all fingers whether somebody listens to the hand."""
        self._wanted[0] = wanted
