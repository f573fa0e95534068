"""A filter for read-only pages: a page may log in, subscribe and acknowledge, but not publish.

Only this module inspects the bytes of a page, packet by packet (MQTT 3.1.1 and 5, section 2.1).
"""

from __future__ import annotations

from typing import Final

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
    """A filter that passes whole packets of one page."""

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
