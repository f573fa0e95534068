"""Debian's python3-systemd, where it is installed,
called so that no thread waits for a peer that does not read.

libsystemd sends without a time limit, and its Python package holds the interpreter's lock
meanwhile: every thread would stand still with it. So `has_room` comes before each call.
"""

from __future__ import annotations

import importlib
import select
import socket
from functools import cache
from typing import Any


@cache
def module(name: str) -> Any:
    """The module ``systemd.NAME``, or None where it is not installed."""
    try:
        return importlib.import_module(f"systemd.{name}")
    # It has no wheel: a Debian package, or a compiler, makes it.
    except ImportError:
        return None


def path_of(address: str) -> str:
    """The name of a Unix socket; with ``@`` in front it is an abstract one (unix(7))."""
    return f"\0{address[1:]}" if address.startswith("@") else address


def has_room(address: str, seconds: float) -> bool:
    """Whether a datagram socket takes one more message, now or within `seconds`.

    Raises OSError if nobody is there.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        probe.settimeout(seconds)
        probe.connect(path_of(address))
        # A connected datagram socket is writable as long as its peer's queue has room.
        return bool(select.select([], [probe], [], seconds)[1])
