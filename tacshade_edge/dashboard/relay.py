"""MQTT over WebSocket to the broker's TCP port, byte by byte;
only read-only pages' bytes are inspected.

mosquitto has a WebSocket listener, but Debian 12's stalls on messages above about 4 KB, and a
height map has 10 to 600.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import ssl
from collections.abc import Coroutine
from dataclasses import dataclass
from typing import Any, Final

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from tacshade_edge.errors import DecodeError

_log = logging.getLogger(__name__)

PACKET_BYTES_MAX: Final = 1 << 16
CLIENT_ID: Final = b"page-"
"""Prefix of a page's client identifier unless that is empty:
another client's identifier would end its connection.
"""

_CONNECT: Final = 1
# PUBACK, PUBREC, PUBREL, PUBCOMP, SUBSCRIBE, UNSUBSCRIBE, PINGREQ, DISCONNECT
# What a page may send without publishing anything: PUBLISH (3) and AUTH (15) are missing.
_PASSING: Final = (4, 5, 6, 7, 8, 10, 12, 14)
_CONNECT_BYTES_MIN: Final = 12  # name, version, flags, keep-alive, and the identifier's length
_CLEAN: Final = 0x02
_WILL: Final = 0x04


class ReadOnly:
    """A filter that passes whole packets of one page, which may log in, subscribe and acknowledge,
    but not publish.
    """

    def __init__(self) -> None:
        self._rest = b""

    def passed(self, data: bytes) -> bytes:
        """Return the packets that are complete.

        Raises DecodeError if one would do more than read; then send none.
        """
        # WebSocket messages need not end where packets do (MQTT 5, 6.0).
        data = self._rest + data
        end = 0
        while (found := _body(data, end)) is not None:
            begin, stop = found
            _check(data[end] >> 4, data[begin:stop])
            end = stop
        self._rest = data[end:]
        return data[:end]


_CONTINUES: Final = 0x80
"""The bit of a length's byte after which another follows (MQTT 5, 1.5.5)."""


def _body(data: bytes, start: int) -> tuple[int, int] | None:
    """Return where the body of the packet at `start` begins and ends; None while incomplete.

    Raises DecodeError.
    """
    size = 0
    # At most four bytes of seven bits each (MQTT 5, 1.5.5).
    for place, byte in enumerate(data[start + 1 : start + 5]):
        size |= (byte & ~_CONTINUES) << 7 * place
        if size > PACKET_BYTES_MAX:
            raise DecodeError(
                f"found a packet of more than {PACKET_BYTES_MAX} bytes, expected at most so many"
            )
        if not byte & _CONTINUES:
            begin = start + place + 2
            return (begin, begin + size) if len(data) >= begin + size else None
    if len(data) >= start + 5:
        raise DecodeError("found no MQTT packet, expected one")
    return None


def _check(kind: int, body: bytes) -> None:
    if kind not in (_CONNECT, *_PASSING):
        raise DecodeError("read-only: this dashboard forwards no requests")
    if kind != _CONNECT:
        return
    name, version, flags, rest = body[:6], body[6:7], body[7:8], body[10:]
    if name != b"\0\4MQTT" or version not in (b"\4", b"\5") or len(body) < _CONNECT_BYTES_MIN:
        raise DecodeError(
            "found an unsupported or incomplete CONNECT packet, expected MQTT 3.1.1 or 5"
        )
    # A last will is a message that the broker publishes for the page; a session that persists
    # queues messages for a page that never comes back.
    if flags[0] & _WILL or not flags[0] & _CLEAN:
        raise DecodeError(
            "read-only: found a last will or a persistent session in CONNECT, expected neither"
        )
    if version == b"\5":
        if rest[0]:  # such as a session that outlives its connection
            raise DecodeError("read-only: found properties in CONNECT, expected none")
        rest = rest[1:]
    client_id = rest[2 : 2 + int.from_bytes(rest[:2])]
    # A page could otherwise take the name of the daemon, which the broker then disconnects.
    if client_id and not client_id.startswith(CLIENT_ID):
        raise DecodeError(
            "read-only: found another client identifier, expected one that starts with "
            f"{CLIENT_ID.decode()}"
        )


# A page sends requests of at most 4 KiB, acknowledgements and pings.
FROM_PAGE_BYTES_MAX: Final = 1 << 16
_CHUNK_BYTES: Final = 1 << 16
_CONNECT_S: Final = 3.0
STALL_S: Final = 10.0
"""The server closes a page that takes longer to accept 64 KiB."""
_TRY_AGAIN: Final = 1013  # WebSocket close code "try again later"
_BINARY_ONLY: Final = 1003
_NOT_ALLOWED: Final = 1008
_REASON_BYTES_MAX: Final = 123
# A broker whose machine vanished without closing the connection is noticed after about 20 s.
_KEEPALIVE: Final = {"TCP_NODELAY": 1, "TCP_KEEPIDLE": 10, "TCP_KEEPINTVL": 5, "TCP_KEEPCNT": 2}


@dataclass(frozen=True, slots=True)
class Broker:
    """The address of the broker; None is no TLS."""

    host: str
    port: int
    tls: ssl.SSLContext | None = None

    def __str__(self) -> str:
        """Return HOST:PORT, as the user wrote it."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


class Bridge:
    """A bridge from any number of pages to one broker; both directions wait for the slower side."""

    def __init__(self, broker: Broker, *, read_only: bool) -> None:
        self._broker = broker
        self._read_only = read_only
        self._away = False

    async def carry(self, page: ServerConnection) -> None:
        """Connect one page to the broker until either side ends;
        the closing frame gives the page the reason.
        """
        try:
            reader, writer = await self._connect()
        # Once, not for every page and try: pages try again every second.
        except (OSError, TimeoutError) as error:
            reason = f"broker {self._broker}: {_reason(error)}"
            if not self._away:
                _log.warning("%s; pages will keep trying to connect", reason)
            self._away = True
            await page.close(_TRY_AGAIN, _short(reason))
            return
        if self._away:
            _log.info("broker %s is reachable again", self._broker)
        self._away = False
        try:
            await _until_first(
                _to_broker(page, writer, ReadOnly() if self._read_only else None),
                _to_page(reader, page),
            )
        finally:
            writer.close()
        await page.close(_TRY_AGAIN, _short(f"broker {self._broker} closed the connection"))

    async def _connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        broker = self._broker
        async with asyncio.timeout(_CONNECT_S):
            reader, writer = await asyncio.open_connection(
                broker.host, broker.port, ssl=broker.tls, limit=_CHUNK_BYTES
            )
        sock = writer.get_extra_info("socket")
        # TCP_NODELAY is set with them: a touch must not wait for the acknowledgement of the one
        # before.
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEPALIVE.items():
            if hasattr(socket, name):
                sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        return reader, writer


async def _to_broker(
    page: ServerConnection, writer: asyncio.StreamWriter, only: ReadOnly | None
) -> None:
    async for message in page:
        if isinstance(message, str):
            await page.close(_BINARY_ONLY, "MQTT is binary")
            return
        try:
            writer.write(only.passed(message) if only else message)
        except DecodeError as refused:
            _log.warning("disconnected a page: %s", refused)
            await page.close(_NOT_ALLOWED, _short(str(refused)))
            return
        # The slower side decides: nothing is queued here, so the broker and the page do it.
        await writer.drain()


async def _to_page(reader: asyncio.StreamReader, page: ServerConnection) -> None:
    """Forward until the broker ends; close a stalled page,
    since the broker queues messages as long as it is there.
    """
    while chunk := await reader.read(_CHUNK_BYTES):
        try:
            async with asyncio.timeout(STALL_S):
                await page.send(chunk)
        except TimeoutError:
            _log.warning("disconnected a page that read nothing for %.0f s", STALL_S)
            # Not `close`, which would wait behind what the page does not read.
            page.transport.abort()
            return


async def _until_first(*ways: Coroutine[Any, Any, None]) -> None:
    """Run both until one ends, then end the other; a side that went away is no error."""
    tasks = [asyncio.ensure_future(way) for way in ways]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        # A task that is only cancelled may still hold its socket; wait for both.
        ended = await asyncio.gather(*tasks, return_exceptions=True)
    for result in ended:
        if isinstance(result, Exception) and not isinstance(result, (ConnectionClosed, OSError)):
            raise result


def _reason(error: OSError | TimeoutError) -> str:
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate is not trusted ({error.verify_message})"
    if isinstance(error, ssl.SSLError):
        return "it does not speak TLS"
    if isinstance(error, TimeoutError):
        return f"no answer within {_CONNECT_S:.0f} s"
    # asyncio's own text repeats the addresses, and has no errno if there were several,
    # as with localhost.
    if f"[Errno {errno.ECONNREFUSED}]" in str(error):
        return "connection refused"
    return str(error.strerror or error)


def _short(reason: str) -> str:
    """Return the reason cut to the 123 bytes that a closing frame can hold."""
    return reason.encode()[:_REASON_BYTES_MAX].decode(errors="ignore")
