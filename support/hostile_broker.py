"""A broker that accepts every client and then sends what no broker should, as raw bytes."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from types import TracebackType


def packet(kind: int, body: bytes) -> bytes:
    """An MQTT packet with a body of up to 2 MB."""
    size, length = len(body), bytearray()
    while size >= 128:
        length.append(size & 127 | 128)
        size >>= 7
    return bytes((kind, *length, size)) + body


def publish(topic: bytes, payload: bytes = b"x") -> bytes:
    """A PUBLISH of MQTT 5, QoS 0, without properties."""
    return packet(0x30, len(topic).to_bytes(2, "big") + topic + b"\0" + payload)


_LONG = b"a" * 65_000
BAD_TOPICS = (
    b"tacshade/\xff\xfe/state",
    b"",
    b"x",
    b"/",
    b"\0",
    b"\xff" * 65_535,
    b"tacshade/test/req/\xff" + _LONG,
    b"tacshade/test/req/#",
    b"tacshade/test/req/+/a",
    b"tacshade/test/req/\x1b[2J",
    b"tacshade/test/req/" + _LONG,
)
BAD = b"".join(map(publish, BAD_TOPICS))
"""Topics that nobody may publish on or that nobody subscribed to."""


class HostileBroker:
    """It grants each subscription with `extra_codes` reason codes too many and sends `raw`
    after it; it denies the first `denied` topics of each.
    It grants nothing while `may_grant` is not set.

    It ends a connection that publishes more than `bytes_max`, and answers others of QoS 1
    with `code`; with `echo`, it sends these back. `early` comes with the first packet, and each of
    the first connections ends after as many bytes as `cuts` say.
    """

    def __init__(
        self,
        *raw: bytes,
        extra_codes: int = 0,
        denied: int = 0,
        bytes_max: int = 1 << 28,
        code: int = 0,
        echo: bool = False,
        early: bytes = b"",
        cuts: Iterable[int] = (),
    ) -> None:
        self._bytes_max, self._code, self._echo = bytes_max, code, echo
        self._raw, self._extra, self.connects = b"".join(raw), extra_codes, 0
        self._denied, self._early, self._cuts = denied, early, iter(cuts)
        self.may_grant = threading.Event()
        self.may_grant.set()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self._peers: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> HostileBroker:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        for peer in self._peers:
            with suppress(OSError):
                peer.shutdown(socket.SHUT_RDWR)

    def send(self, raw: bytes) -> None:
        """Send bytes to the latest client."""
        self._peers[-1].sendall(raw)

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                peer, _ = self._server.accept()
                self._peers.append(peer)
                self.connects += 1
                threading.Thread(target=self._serve, args=(peer,), daemon=True).start()

    def _serve(self, peer: socket.socket) -> None:
        send = _cut_off(peer, next(self._cuts, None))
        with suppress(OSError, EOFError), peer, peer.makefile("rb") as stream:
            while True:
                kind, body = _read(stream.read)
                if kind == 0x10:
                    send(packet(0x20, b"\0\0\0") + self._early)
                elif kind == 0x82:
                    self.may_grant.wait()
                    granted = bytes(_filters(body) + self._extra - self._denied)
                    codes = b"\x87" * self._denied + granted
                    send(packet(0x90, body[:2] + b"\0" + codes) + self._raw)
                elif kind & 0xF0 == 0x30 and len(body) > self._bytes_max:
                    return
                elif kind & 0xF6 == 0x32:
                    size = int.from_bytes(body[:2], "big")
                    peer.sendall(
                        packet(
                            0x40,
                            body[2 + size : 4 + size] + bytes((self._code,) if self._code else ()),
                        )
                    )
                    if self._echo:
                        peer.sendall(packet(0x30, body[: 2 + size] + body[4 + size :]))
                elif kind == 0xC0:
                    peer.sendall(packet(0xD0, b""))


def _cut_off(peer: socket.socket, bytes_max: int | None) -> Callable[[bytes], None]:
    """Send all, or a byte at a time and so many bytes of all, then EOFError."""
    left = bytes_max

    def send(data: bytes) -> None:
        nonlocal left
        if left is None:
            peer.sendall(data)
            return
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for k in range(min(left, len(data))):
            peer.sendall(data[k : k + 1])
        left -= len(data)
        if left <= 0:
            raise EOFError

    return send


def _read(read: Callable[[int], bytes]) -> tuple[int, bytes]:
    head = read(1)
    if not head:
        raise EOFError
    size = shift = 0
    while True:
        byte = read(1)[0]
        size, shift = size | (byte & 127) << shift, shift + 7
        if byte < 128:
            return head[0], read(size)


def _filters(body: bytes) -> int:
    """How many topic filters a SUBSCRIBE without properties has."""
    at, count = 3 + body[2], 0
    while at < len(body):
        at += 3 + int.from_bytes(body[at : at + 2], "big")
        count += 1
    return count
