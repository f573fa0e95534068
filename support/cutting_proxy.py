"""A way to a server that cuts what it carries off in the middle, as a bad network does."""

from __future__ import annotations

import contextlib
import socket
import socketserver
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

_CHUNK_BYTES = 1 << 16


class CuttingProxy:
    """Cuts the answers to requests for `path` after so many bytes, one after another; later ones
    and all others are whole.
    """

    def __init__(self, port: int, path: str, after_bytes: Sequence[int]) -> None:
        self.requests: list[str] = []
        """The requests for the path."""
        self._to, self._path, self._left = ("127.0.0.1", port), path, list(after_bytes)

    def carry(self, client: socket.socket) -> None:
        """Carry one connection until an end closes it, or it is cut."""
        with socket.create_connection(self._to) as server:
            head = client.recv(_CHUNK_BYTES)
            limit = float("inf")
            if head.startswith(f"GET {self._path} ".encode()):
                self.requests.append(head.decode())
                limit = self._left.pop(0) if self._left else limit
            server.sendall(head)
            back = threading.Thread(target=_copy, args=(client, server))
            back.start()
            _copy(server, client, limit)
            # Which wakes the other thread, as closing would not.
            for end in (client, server):
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
            back.join()


def _copy(start: socket.socket, end: socket.socket, limit: float = float("inf")) -> None:
    """Copy until the end, or so many bytes."""
    with contextlib.suppress(OSError):
        while piece := start.recv(_CHUNK_BYTES):
            end.sendall(piece)
            limit -= len(piece)
            if limit <= 0:
                return
        end.shutdown(socket.SHUT_WR)


@contextmanager
def cutting_proxy(
    port: int, path: str, after_bytes: Sequence[int]
) -> Iterator[tuple[int, CuttingProxy]]:
    """Run one on a free port; yield the port and the proxy."""
    proxy = CuttingProxy(port, path, after_bytes)

    class Handler(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            proxy.carry(self.request)

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as listening:
        listening.daemon_threads = True
        threading.Thread(target=listening.serve_forever, args=(0.05,)).start()
        try:
            yield listening.server_address[1], proxy
        finally:
            listening.shutdown()
