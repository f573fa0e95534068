"""How many connections the page's server holds, and how much for each: whoever reaches the port can open them."""

from __future__ import annotations

import asyncio
import logging
import socket
from typing import Any, Final

from websockets.asyncio.server import ServerConnection

from tacshade_edge.devices.listener import Connections

_log = logging.getLogger(__name__)

CONNECTIONS_MAX: Final = 48
"""Of pages, of requests for files, and of what has not said yet what it is; what is more is closed at once."""
PAGES_MAX: Final = 16
"""WebSockets; each is a connection to the broker too, which holds up to 20 messages for one that does not read."""
UNSENT_BYTES_MAX: Final = 1 << 20
"""What a peer may make us answer (pongs) without reading it; our own messages wait long before."""


class Bounds:
    """What is open now, and how many were turned away."""

    def __init__(self) -> None:
        self._connections = Connections(CONNECTIONS_MAX)
        self._pages: set[ServerConnection] = set()
        self.turned_away = 0

    def admit(self, connection: socket.socket) -> bool:
        """Count a connection; False when there are too many."""
        if admitted := self._connections.admit(connection):
            return admitted
        self._turn_away(f"{CONNECTIONS_MAX} connections are already open, the limit")
        return False

    def admit_page(self, connection: ServerConnection) -> str:
        """Count a connection as a page's; why not, when there are too many."""
        if len(self._pages) >= PAGES_MAX:
            return self._turn_away(f"{PAGES_MAX} pages are already open, the limit")
        self._pages.add(connection)
        return ""

    def release(self, connection: ServerConnection) -> None:
        """A page is over."""
        self._pages.discard(connection)

    def _turn_away(self, why: str) -> str:
        self.turned_away += 1
        _log.warning("turned a connection away (%d so far): %s", self.turned_away, why)
        return why


def bounded(bounds: Bounds) -> type[ServerConnection]:
    """The kind of connection that keeps to `bounds`."""

    class Connection(ServerConnection):
        def connection_lost(self, exc: Exception | None) -> None:
            bounds.release(self)
            super().connection_lost(exc)

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            if self.transport.get_write_buffer_size() > UNSENT_BYTES_MAX:
                _log.warning("disconnected a page that sends but does not read")
                self.transport.abort()

    return Connection


def report_device_errors(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Exception handler of a loop: no traceback for what the system refuses, such as one more open file."""
    if isinstance(error := context.get("exception"), OSError):
        _log.warning("%s: %s", context.get("message", "the system refused a connection"), error.strerror or error)
    else:
        loop.default_exception_handler(context)
