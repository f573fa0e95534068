"""A client that reads a byte now and then, beside one that reads all and a hundred that come and
go: for each kind of client, the one gets every frame before the next is sent, and the memory of
all programs between them is bounded.
"""

from __future__ import annotations

import base64
import contextlib
import json
import re
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from support.mqtt_rig import Broker, Subscriber
from support.patience import patience, wait_until
from support.processes import memory_mb
from support.published_sensor import CRC, PublishedSensor, bump, health
from tacshade_edge.wire import binary

pytestmark = [pytest.mark.broker, pytest.mark.slow]
CLIENTS = 100
"""Each comes and goes with a frame; 0.6 MB each for the broker, and 1.2 MB for a viewer."""
MORE_MB_MAX = 40
HEIGHT = "tacshade/drawn/height"
# Of MQTT 3.1.1: CONNECT without a name and a keep-alive; SUBSCRIBE with QoS 0.
ASKED = b"\x10\x0c\0\4MQTT\4\2\0\0\0\0" + b"\x82" + bytes((len(HEIGHT) + 5,)) + b"\0\1\0"
ASKED += bytes((len(HEIGHT),)) + HEIGHT.encode() + b"\0"


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of client: where it connects, what it says to get all frames, and whether one that
    reads all has got a frame.
    """

    port: int
    pids: tuple[int, ...]
    asking: bytes
    got: Callable[[int], bool]


@contextmanager
def program(never: str, *words: str) -> Iterator[tuple[int, int]]:
    """One of our programs, with a time after which it would give up a slow client that `never`
    comes; its process and its port.
    """
    module, _, name = never.rpartition(".")
    text = f"import {module} as slow, sys; from tacshade_edge.cli import main\n"
    text += f"slow.{name} = 1e9; sys.exit(main(sys.argv[1:]))"
    with subprocess.Popen(
        [sys.executable, "-c", text, *words], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            found = re.search(r"://[^ /]*:(\d+)", process.stdout.readline())
            assert found
            yield process.pid, int(found[1])
            process.terminate()
            assert process.wait(patience(10)) == 0
        finally:
            process.kill()


def upgrade(path: str, protocol: str, said: bytes, opcode: int) -> bytes:
    """A WebSocket's opening and its first message."""
    lines = [f"GET {path} HTTP/1.1", "Host: 127.0.0.1", "Connection: Upgrade", "Upgrade: websocket"]
    lines += ["Sec-WebSocket-Version: 13", f"Sec-WebSocket-Protocol: {protocol}"]
    lines += [f"Sec-WebSocket-Key: {base64.b64encode(bytes(16)).decode()}", "", ""]
    # Masked with zeros.
    frame = bytes((0x80 | opcode, 0x80 | len(said))) + bytes(4) + said
    return "\r\n".join(lines).encode() + frame


@contextmanager
def subscriber(broker: Broker) -> Iterator[Kind]:
    with Subscriber(broker.port, HEIGHT) as all_:
        yield Kind(broker.port, (broker.pid,), ASKED, got_by(all_))


def got_by(reader: Subscriber) -> Callable[[int], bool]:
    """Whether it has got a frame; what came before is forgotten."""

    def got(seq: int) -> bool:
        while reader.messages:
            if binary.decode(reader.messages.pop(0).payload).seq == seq:
                return True
        return False

    return got


@contextmanager
def page(broker: Broker) -> Iterator[Kind]:
    words = ("dashboard", "--broker", f"127.0.0.1:{broker.port}", "--http", "0")
    with (
        program("tacshade_edge.dashboard.relay.STALL_S", *words) as (pid, port),
        Subscriber(port, HEIGHT, page=True) as all_,
    ):
        asking = upgrade("/mqtt", "mqtt", ASKED, 2).replace(
            b"Host: 127.0.0.1",
            f"Host: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}".encode(),
        )
        yield Kind(port, (pid, broker.pid), asking, got_by(all_))


@contextmanager
def viewer(broker: Broker) -> Iterator[Kind]:
    pytest.importorskip("foxglove", reason="the extra foxglove is not installed")
    connect = pytest.importorskip("websockets.sync.client").connect
    images = pytest.importorskip("foxglove_schemas_protobuf.RawImage_pb2")

    def seconds_of(image: bytes) -> int:
        return int(images.RawImage.FromString(image).timestamp.seconds)

    words = ("bridge", "foxglove", "--listen", "127.0.0.1:0")
    with (
        program(
            "tacshade_edge.bridge.viewers._STALL_S",
            *words,
            "--broker",
            f"127.0.0.1:{broker.port}",
        ) as (pid, port),
        connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], max_size=None) as all_,
    ):
        topics: dict[str, int] = {}
        while "/tacshade/drawn/height" not in topics:
            heard = all_.recv(patience(30))
            if isinstance(heard, str):
                topics |= {
                    each["topic"]: each["id"] for each in json.loads(heard).get("channels", ())
                }
        wanted = {"id": 0, "channelId": topics["/tacshade/drawn/height"]}
        said = json.dumps({"op": "subscribe", "subscriptions": [wanted]}, separators=(",", ":"))
        all_.send(said)

        def got(seq: int) -> bool:
            with contextlib.suppress(TimeoutError):
                while True:
                    heard = all_.recv(0.05)
                    if not isinstance(heard, str) and seconds_of(heard[13:]) == seq:
                        return True
            return False

        yield Kind(port, (pid, broker.pid), upgrade("/", "foxglove.sdk.v1", said.encode(), 1), got)


@contextmanager
def scraper(broker: Broker) -> Iterator[Kind]:
    pytest.importorskip("prometheus_client", reason="the extra prometheus is not installed")
    words = ("bridge", "prometheus", "--listen", "127.0.0.1:0")
    with program(
        "tacshade_edge.bridge.prometheus._SPEAK_S",
        *words,
        "--broker",
        f"127.0.0.1:{broker.port}",
    ) as (pid, port):
        asking = b"GET /metrics HTTP/1.1\r\nHost: a\r\n\r\n"

        def got(_: int) -> bool:
            with socket.create_connection(("127.0.0.1", port), patience(30)) as asked:
                asked.sendall(asking)
                got = b"".join(iter(lambda: asked.recv(1 << 16), b""))
            return b'tacshade_up{sensor="drawn"} 1.0' in got

        yield Kind(port, (pid, broker.pid), asking, got)


@contextmanager
def joined(kind: Kind) -> Iterator[socket.socket]:
    """A client that has asked for everything; it goes without a word."""
    with socket.socket() as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 14)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.settimeout(patience(30))
        client.connect(("127.0.0.1", kind.port))
        client.sendall(kind.asking)
        yield client


def descriptors(pid: int) -> int:
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))


@pytest.mark.parametrize("kind", [subscriber, page, viewer, scraper])
def test_no_frame_waits_for_who_reads_a_byte_now_and_then(
    kind: Callable[[Broker], Any], tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    record_property("tried", CLIENTS)
    press = bump(0, 2.0, 236.0, 328.0)
    with ExitStack() as stack:
        broker = stack.enter_context(Broker(tmp_path))
        sensor = stack.enter_context(PublishedSensor(broker.port))
        made = stack.enter_context(kind(broker))

        def show(seq: int) -> None:
            shown = replace(press, seq=seq, wall_ns=seq * 10**9)
            sensor.publish("height", binary.encode_height(shown, calibration_crc32=CRC))
            sensor.publish("health", health())

        def first() -> bool:  # a bridge subscribes a moment after a viewer
            show(1)
            return made.got(1)

        wait_until(first, 30, "the first frame")
        before = {pid: (memory_mb(pid), descriptors(pid)) for pid in made.pids}
        with joined(made) as slow:
            for seq in range(2, 2 + CLIENTS):
                with joined(made) as gone:
                    show(seq)
                    wait_until(lambda seq=seq: made.got(seq), 30, f"frame {seq}")
                    gone.recv(1 + seq % 3)
                with contextlib.suppress(TimeoutError):
                    slow.recv(1)
                for pid in made.pids:
                    more_mb = memory_mb(pid) - before[pid][0]
                    assert more_mb < MORE_MB_MAX, f"{more_mb:.0f} MB more after {seq} frames"
        for pid in made.pids:
            wait_until(lambda pid=pid: descriptors(pid) <= before[pid][1], 30, "all are gone")
