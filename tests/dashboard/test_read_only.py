from __future__ import annotations

import socket
import threading
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from support.hostile_broker import packet
from support.patience import patience
from tacshade_edge.dashboard.relay import PACKET_BYTES_MAX, ReadOnly
from tacshade_edge.errors import DecodeError

V311, V5 = MQTTProtocolVersion.MQTTv311, MQTTProtocolVersion.MQTTv5


PING, SUBSCRIBE = packet(0xC0, b""), packet(0x80, b"\0\1\0\x08tacshade\0")


def connect(
    version: int = 5,
    flags: int = 2,
    properties: bytes = b"",
    client_id: bytes = b"page-1",
    name: bytes = b"MQTT",
) -> bytes:
    body = len(name).to_bytes(2, "big") + name + bytes([version, flags, 0, 15])
    body += bytes([len(properties)]) + properties if version == 5 else b""
    return packet(0x10, body + len(client_id).to_bytes(2, "big") + client_id)


def sent_by_paho(
    version: MQTTProtocolVersion, prepare: Callable[[Client], None], **connecting: object
) -> bytes:
    """The CONNECT of a client that others wrote."""
    received: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def accept() -> None:
            connection, _ = server.accept()
            with connection:
                connection.settimeout(patience(10))
                received.append(connection.recv(4096))

        thread = threading.Thread(target=accept)
        thread.start()
        client = Client(CallbackAPIVersion.VERSION2, client_id="page-paho", protocol=version)
        prepare(client)
        client.connect("127.0.0.1", server.getsockname()[1], **connecting)  # type: ignore[arg-type]
        thread.join()
        client.disconnect()
    return received[0]


@pytest.mark.parametrize("version", [V311, V5])
def test_who_only_looks_passes(version: MQTTProtocolVersion) -> None:
    hello = sent_by_paho(version, lambda client: client.username_pw_set("eve", "right"))
    acknowledged = packet(0x40, b"\0\1")
    sent = hello + SUBSCRIBE + acknowledged + PING + packet(0xA0, b"\0\2\0\1a") + packet(0xE0, b"")
    assert ReadOnly().passed(sent) == sent


def test_a_last_will_is_a_message_too_and_nothing_is_kept_for_a_page_that_is_gone() -> None:
    properties = Properties(PacketTypes.CONNECT)
    properties.SessionExpiryInterval = 10
    for version in (V311, V5):
        with pytest.raises(DecodeError, match="last will"):
            ReadOnly().passed(
                sent_by_paho(
                    version, lambda client: client.will_set("tacshade/a/req/reference", b"{}")
                )
            )
    with pytest.raises(DecodeError, match="persistent session"):
        ReadOnly().passed(connect(4, flags=0))
    with pytest.raises(DecodeError, match="properties"):
        ReadOnly().passed(sent_by_paho(V5, lambda _: None, properties=properties))


@pytest.mark.parametrize(
    "hello",  # with a length that is right
    [
        connect(client_id=b"tacshade-left-index"),  # would end the daemon's connection
        connect(version=3, name=b"MQIsdp"),
        connect(version=0x84),  # a bridge of mosquitto's
        connect(properties=b"\x26\0\1a\0\1b"),
        connect()[:-9],
        connect(properties=b"\x21\0")[:20],
        packet(0x10, b""),
        packet(0x10, b"\0\4MQTT\5"),
        packet(0x10, b"\0\4MQTT\5\2\0\x0f\xff\xff\xff\x7f"),
    ],
)
def test_other_ways_to_say_hello_are_refused(hello: bytes) -> None:
    with pytest.raises(DecodeError):
        ReadOnly().passed(packet(0x10, hello[2:]))


def test_what_is_not_looking_is_refused() -> None:
    for kind in (0, 1, 2, 3, 9, 11, 13, 15):
        for flags in (0, 2, 15):
            with pytest.raises(DecodeError):
                ReadOnly().passed(PING + bytes([kind << 4 | flags]) + b"\x03\0\1a")


def test_what_is_too_large_is_refused_before_it_is_there() -> None:
    size = packet(0x80, bytes(PACKET_BYTES_MAX + 1))
    with pytest.raises(DecodeError, match="more than 65536 bytes"):
        ReadOnly().passed(size[:8])
    with pytest.raises(DecodeError, match="no MQTT"):
        ReadOnly().passed(b"\x80" * 5)


@given(st.data())
def test_however_it_is_cut_only_whole_packets_pass(data: st.DataObject) -> None:
    sent = connect() + SUBSCRIBE + packet(0x80, bytes(200)) + PING
    cuts = sorted(data.draw(st.lists(st.integers(0, len(sent)), max_size=20)))
    only = ReadOnly()
    parts = [
        only.passed(sent[start:end])
        for start, end in zip([0, *cuts], [*cuts, len(sent)], strict=True)
    ]
    assert b"".join(parts) == sent
    ends = {len(connect()), len(connect() + SUBSCRIBE), len(sent) - 2, len(sent)}
    passed = 0
    for part in parts:
        passed += len(part)
        assert not part or passed in ends
    publish = packet(0x30, b"\0\1a")
    cut = data.draw(st.integers(0, len(publish)))
    assert only.passed(publish[:cut] if cut < len(publish) else b"") == b""
    with pytest.raises(DecodeError):
        only.passed(publish[cut:] if cut < len(publish) else publish)


@given(st.binary(max_size=300))
def test_no_bytes_are_a_crash(data: bytes) -> None:
    try:
        passed = ReadOnly().passed(data)
    except DecodeError:
        return
    assert data.startswith(passed)
