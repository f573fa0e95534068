"""MQTT over WebSocket to the broker's TCP port, byte by byte.

mosquitto has a WebSocket listener, but Debian 12's stalls on messages above about 4 KB, and a height map has 10 to 600.
The bridge does not inspect the bytes, except for read-only pages (`read_only`): user, password and permissions are
between the page and the broker.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import socket
import ssl
from collections.abc import Coroutine
from dataclasses import dataclass
from typing import Any, Final

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from tacshade_edge.errors import DecodeError

PACKET_BYTES_MAX: Final = 1 << 16
CLIENT_ID: Final = b"page-"
"""Prefix of a page's client identifier unless that is empty: another client's identifier would end its connection."""

_CONNECT: Final = 1
_PUBLISH: Final = 3
# PUBACK, PUBREC, PUBREL, PUBCOMP, SUBSCRIBE, UNSUBSCRIBE, PINGREQ, DISCONNECT
_PASSING: Final = (4, 5, 6, 7, 8, 10, 12, 14)
_CLEAN: Final = 0x02
_WILL: Final = 0x04
# CONNECT properties of MQTT 5, bytes by identifier: session expiry, request problem and response information, receive
# maximum, topic alias maximum, maximum packet size.
_SESSION_EXPIRY: Final = 0x11
_PROPERTIES: Final = {_SESSION_EXPIRY: 4, 0x17: 1, 0x19: 1, 0x21: 2, 0x22: 2, 0x27: 4}


class ReadOnly:
    """A filter that passes whole packets of one page, which may log in, subscribe and acknowledge, but not publish.

    Only this inspects a page's bytes, packet by packet (MQTT 3.1.1 and 5, section 2.1).
    """

    def __init__(self) -> None:
        self._rest = b""

    def passed(self, data: bytes) -> bytes:
        """Return the packets that are complete now, unchanged.

        Raises DecodeError if one of them would do more than read, or is not MQTT; the caller must send none of them.
        """
        data = self._rest + data
        end = 0
        while (size := _packet_bytes(data, end)) is not None:
            _check(data[end : end + size])
            end += size
        self._rest = data[end:]
        return data[:end]


def _packet_bytes(data: bytes, start: int) -> int | None:
    """Return the length of the packet at `start`; None while it is incomplete. Raises DecodeError."""
    found = _varint(data, start + 1)
    if found is None:
        return None
    remaining, header = found[0], found[1] - start
    if remaining > PACKET_BYTES_MAX:
        raise DecodeError(f"found a packet of {remaining} bytes, expected at most {PACKET_BYTES_MAX} bytes")
    return header + remaining if len(data) - start >= header + remaining else None


def _check(packet: bytes) -> None:
    kind = packet[0] >> 4
    if kind == _PUBLISH:
        raise DecodeError("read-only: this dashboard forwards no requests")
    if kind == _CONNECT:
        try:
            _check_connect(packet)
        except IndexError:
            raise DecodeError("found an incomplete CONNECT packet, expected a complete one") from None
    elif kind not in _PASSING:
        raise DecodeError(f"read-only: this dashboard forwards no packets of type {kind}")


def _check_connect(packet: bytes) -> None:
    found = _varint(packet, 1)
    assert found is not None  # its length was read before
    at = found[1]
    if packet[at : at + 6] != b"\0\4MQTT" or packet[at + 6] not in (4, 5):
        raise DecodeError("found an unsupported protocol, expected MQTT 3.1.1 or 5")
    version, flags = packet[at + 6], packet[at + 7]
    if flags & _WILL:
        raise DecodeError("read-only: found a last will in CONNECT, expected none")
    if not flags & _CLEAN:
        raise DecodeError("read-only: found a persistent session, expected a clean one")
    at += 10  # name, version, flags, keep alive
    if version == 5:
        at = _after_properties(packet, at)
    length = packet[at] << 8 | packet[at + 1]
    client_id = packet[at + 2 : at + 2 + length]
    if client_id and not client_id.startswith(CLIENT_ID):
        raise DecodeError(
            f"read-only: found another client identifier, expected one that starts with {CLIENT_ID.decode()}"
        )


def _after_properties(packet: bytes, at: int) -> int:
    found = _varint(packet, at)
    if found is None:
        raise IndexError
    length, at = found
    end = at + length
    while at < end:
        identifier = packet[at]
        if identifier not in _PROPERTIES:
            raise DecodeError(
                f"read-only: found property {identifier} in CONNECT, expected only properties that a page sends"
            )
        value = packet[at + 1 : at + 1 + _PROPERTIES[identifier]]
        if identifier == _SESSION_EXPIRY and any(value):
            raise DecodeError("read-only: found a persistent session, expected a session that ends with its connection")
        at += 1 + len(value)
    if at != end or end > len(packet):
        raise IndexError
    return at


def _varint(data: bytes, at: int) -> tuple[int, int] | None:
    """Return a variable byte integer and the index after it; None if the data ends first. Raises DecodeError."""
    value = 0
    for place in range(4):
        if at + place >= len(data):
            return None
        byte = data[at + place]
        value |= (byte & 0x7F) << 7 * place
        if not byte & 0x80:
            return value, at + place + 1
    raise DecodeError("found no MQTT packet, expected one")


_log = logging.getLogger(__name__)

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
_BROKER_SOCKET: Final = (
    (socket.IPPROTO_TCP, "TCP_NODELAY", 1),
    (socket.SOL_SOCKET, "SO_KEEPALIVE", 1),
    (socket.IPPROTO_TCP, "TCP_KEEPIDLE", 10),
    (socket.IPPROTO_TCP, "TCP_KEEPINTVL", 5),
    (socket.IPPROTO_TCP, "TCP_KEEPCNT", 2),
)


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
    """A bridge from any number of pages to one broker; each page has its own TCP connection.

    Both directions wait for the slower side, with at most about 100 KB in between: if a page does not keep up, the
    broker drops messages by its own rules.
    """

    def __init__(self, broker: Broker, *, read_only: bool) -> None:
        self._broker = broker
        self._read_only = read_only
        self._away = False

    async def carry(self, page: ServerConnection) -> None:
        """Connect one page to the broker until either side ends; the closing frame gives the page the reason."""
        try:
            reader, writer = await self._connect()
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
                _to_broker(page, writer, ReadOnly() if self._read_only else None), _to_page(reader, page)
            )
        finally:
            writer.close()
        await page.close(_TRY_AGAIN, _short(f"broker {self._broker} closed the connection"))

    async def _connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        broker = self._broker
        async with asyncio.timeout(_CONNECT_S):
            reader, writer = await asyncio.open_connection(broker.host, broker.port, ssl=broker.tls, limit=_CHUNK_BYTES)
        sock = writer.get_extra_info("socket")
        for level, name, value in _BROKER_SOCKET:
            if hasattr(socket, name):
                sock.setsockopt(level, getattr(socket, name), value)
        return reader, writer


async def _to_broker(page: ServerConnection, writer: asyncio.StreamWriter, only: ReadOnly | None) -> None:
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
        await writer.drain()


async def _to_page(reader: asyncio.StreamReader, page: ServerConnection) -> None:
    """Forward until the broker ends; close a stalled page, since the broker queues messages as long as it is there."""
    while chunk := await reader.read(_CHUNK_BYTES):
        try:
            async with asyncio.timeout(STALL_S):
                await page.send(chunk)
        except TimeoutError:
            _log.warning("disconnected a page that read nothing for %.0f s", STALL_S)
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
        ended = await asyncio.gather(*tasks, return_exceptions=True)
    for result in ended:
        if isinstance(result, Exception) and not isinstance(result, (ConnectionClosed, OSError)):
            raise result


def _reason(error: OSError | TimeoutError) -> str:
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate is not trusted ({error.verify_message})"
    if isinstance(error, ssl.SSLError):
        return "it does not speak TLS"
    if isinstance(error, socket.gaierror):
        return "no such host name"
    if isinstance(error, TimeoutError):
        return f"no answer within {_CONNECT_S:.0f} s"
    # asyncio's own text repeats the addresses, and has no errno if there were several, as with localhost.
    if isinstance(error, ConnectionRefusedError) or f"[Errno {errno.ECONNREFUSED}]" in str(error):
        return "connection refused"
    return os.strerror(error.errno) if error.errno else str(error)


def _short(reason: str) -> str:
    """Return the reason cut to the 123 bytes that a closing frame can hold."""
    return reason.encode()[:_REASON_BYTES_MAX].decode(errors="ignore")
