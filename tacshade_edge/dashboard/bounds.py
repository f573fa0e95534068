"""Limits on the connections of the page's server and on their buffers: anyone who reaches the port can open them."""

from __future__ import annotations

import asyncio
import logging
import socket
from typing import Any, Final

from websockets.asyncio.server import ServerConnection

from tacshade_edge.devices.listener import Connections

_log = logging.getLogger(__name__)

CONNECTIONS_MAX: Final = 48
"""Pages, file requests and connections that have sent nothing yet; the server closes any further one at once."""
PAGES_MAX: Final = 16
"""WebSockets; each also opens a connection to the broker, which queues up to 20 messages if the page does not read."""
UNSENT_BYTES_MAX: Final = 1 << 20
"""Answers (pongs) in bytes that a peer may leave unread; our own messages wait long before that."""


class Bounds:
    """The open connections and pages, and the number turned away."""

    def __init__(self) -> None:
        self._connections = Connections(CONNECTIONS_MAX)
        self._pages: set[ServerConnection] = set()
        self.turned_away = 0

    def admit(self, connection: socket.socket) -> bool:
        """Count a connection; return False when too many are open."""
        if admitted := self._connections.admit(connection):
            return admitted
        self._turn_away(f"{CONNECTIONS_MAX} connections are already open, the limit")
        return False

    def admit_page(self, connection: ServerConnection) -> str:
        """Count a connection as a page; return why it is rejected when too many are open, else an empty text."""
        if len(self._pages) >= PAGES_MAX:
            return self._turn_away(f"{PAGES_MAX} pages are already open, the limit")
        self._pages.add(connection)
        return ""

    def release(self, connection: ServerConnection) -> None:
        """Remove a page that has ended."""
        self._pages.discard(connection)

    def _turn_away(self, why: str) -> str:
        self.turned_away += 1
        _log.warning("rejected a connection (%d so far): %s", self.turned_away, why)
        return why


def bounded(bounds: Bounds) -> type[ServerConnection]:
    """Return the connection class that enforces `bounds`."""

    class Connection(ServerConnection):
        def connection_lost(self, exc: Exception | None) -> None:
            bounds.release(self)
            super().connection_lost(exc)

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            if self.transport.get_write_buffer_size() > UNSENT_BYTES_MAX:
                _log.warning("disconnected a page that kept sending messages but read none")
                self.transport.abort()

    return Connection


def report_device_errors(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Handle a loop's exception: no traceback for what the system refuses, such as one more open file."""
    if isinstance(error := context.get("exception"), OSError):
        _log.warning("%s: %s", context.get("message", "the system refused a connection"), error.strerror or error)
    else:
        loop.default_exception_handler(context)
