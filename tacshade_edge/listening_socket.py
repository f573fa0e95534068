"""A listening TCP socket that limits how many connections are open."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Any


class Connections:
    """The open connections, at most `most`."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._open: list[socket.socket] = []

    def admit(self, connection: socket.socket) -> bool:
        """Count a connection; return False when too many are open."""
        # A closed socket has the number -1, so nobody has to report an end.
        self._open = [other for other in self._open if other.fileno() >= 0]
        if len(self._open) >= self._most:
            return False
        self._open.append(connection)
        return True


class ListeningSocket(socket.socket):
    """A listening TCP socket that accepts only the connections that `admit` lets in.

    It calls `admit` before a connection costs anything: with TLS a connection costs 256 KiB before
    asyncio reports it, and in a threaded server it costs a thread.

    Raises OSError (the address does not exist, or its port is in use).
    """

    def __init__(self, host: str, port: int, admit: Callable[[socket.socket], bool]) -> None:
        # The first one, which the system prefers: a name can have an address of each IP version.
        family, *_, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        super().__init__(family, socket.SOCK_STREAM)
        self._admit = admit
        try:
            # After a restart, the port's last connections still time out for a minute.
            self.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self.bind(address)
        except OSError:
            self.close()
            raise

    def accept(self) -> tuple[socket.socket, Any]:
        """Return the next connection; raises ConnectionAbortedError,
        which asyncio and socketserver ignore.
        """
        connection, address = super().accept()
        if not self._admit(connection):
            connection.close()
            raise ConnectionAbortedError
        return connection, address
