#!/usr/bin/env python3
"""What a message to the broker costs at 60 frames a second through the daemon's link, paho alone, and a bare socket.

::

    .venv/bin/python -m tools.benchmarks.mqtt_message [--rounds 3] [--seconds 5]

Each way publishes the messages of a frame in contact (height, cloud, shear, sigma and contact) at QoS 0 to a mosquitto
with a subscriber on a loopback port, and sleeps until the next frame. CPU counts all threads of this process;
`publishing` is how long the publishing thread is busy. The bare socket writes ready packets in one call: no client
takes less. Rounds take turns; each figure is the median over rounds.
"""

from __future__ import annotations

import argparse
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from tacshade_edge.devices.mqtt.client import BrokerAddress, connect, make_client, publish_properties
from tacshade_edge.devices.mqtt.link import MqttLink
from tacshade_edge.devices.mqtt.outgoing import CONTENT_TYPES
from tacshade_edge.studies.tables import markdown
from tools.testbed.daemon_rig import BASE, broker

FPS = 60
PAYLOAD_BYTES = {"height": 5400, "cloud": 9900, "shear": 10700, "sigma": 5400, "contact": 600}
"""Sizes with profile `balanced` at 640x480 and a ball over a fifth of the disc."""

Publish = Callable[[int], None]


def by_link(port: int, stack: ExitStack) -> Publish:
    """Publish through the daemon's link."""
    link = MqttLink(
        host="127.0.0.1",
        port=port,
        base_topic=BASE,
        client_id="bench",
        on_request=lambda _: None,
        on_outcome=lambda *_: None,
    )
    link.start()
    stack.callback(link.stop, 1.0)
    wait_for(lambda: link.reason is None)

    def publish(seq: int) -> None:
        for topic, size in PAYLOAD_BYTES.items():
            link.offer(topic, bytes(size), seq)

    return publish


def by_paho(port: int, stack: ExitStack) -> Publish:
    """Publish through paho alone, set up as the link sets it up."""
    address = BrokerAddress(host="127.0.0.1", port=port, username=None, password=None, tls_ca=None)
    client = make_client(address, base_topic=BASE, client_id="bench-paho")
    connect(client, "127.0.0.1", port)
    stack.callback(client.loop_stop)
    stack.callback(client.disconnect)
    wait_for(client.is_connected)
    properties = {topic: properties_of(topic) for topic in PAYLOAD_BYTES}

    def publish(_seq: int) -> None:
        for topic, size in PAYLOAD_BYTES.items():
            client.publish(f"{BASE}/{topic}", bytes(size), 0, False, properties[topic])

    return publish


def by_socket(port: int, stack: ExitStack) -> Publish:
    """Write ready MQTT 5 packets in one call."""
    sock = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
    sock.sendall(packet(0x10, b"\x00\x04MQTT\x05\x02\x00\x00\x00" + string("bench-socket")))
    sock.recv(1024)
    packets = b"".join(
        packet(0x30, string(f"{BASE}/{topic}") + properties_of(topic).pack() + bytes(size))
        for topic, size in PAYLOAD_BYTES.items()
    )

    def publish(_seq: int) -> None:
        sock.sendall(packets)

    return publish


def properties_of(topic: str):  # type: ignore[no-untyped-def]
    """The properties that the link sends with a topic."""
    return publish_properties(CONTENT_TYPES.get(topic, "application/json"), expiry_s=5)


def string(text: str) -> bytes:
    """A UTF-8 encoded string (MQTT 5, section 1.5.4)."""
    return len(text).to_bytes(2, "big") + text.encode()


def packet(kind: int, body: bytes) -> bytes:
    """A packet: fixed header (section 2.1.1) and body."""
    length, size = bytearray(), len(body)
    while True:
        size, seven = divmod(size, 128)
        length.append(seven | (128 if size else 0))
        if not size:
            return bytes([kind]) + bytes(length) + body


def wait_for(true: Callable[[], bool]) -> None:
    """Wait until the condition holds."""
    while not true():
        threading.Event().wait(0.02)


def take(port: int) -> None:
    """Subscribe to every topic until killed."""
    client = Client(CallbackAPIVersion.VERSION2)
    client.connect("127.0.0.1", port)
    client.subscribe(f"{BASE}/#")
    client.loop_forever()


def measured(publish: Publish, seconds: float) -> tuple[float, float]:
    """CPU time of this process and wall time of the publishing thread, in ms per frame."""
    count = round(seconds * FPS)
    kept_ns = 0
    used_s, next_s = time.process_time(), time.monotonic()
    for seq in range(count):
        next_s += 1 / FPS
        time.sleep(max(0.0, next_s - time.monotonic()))
        began_ns = time.perf_counter_ns()
        publish(seq)
        kept_ns += time.perf_counter_ns() - began_ns
    return 1e3 * (time.process_time() - used_s) / count, kept_ns / 1e6 / count


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="What a message to the broker costs.")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each way in each round")
    parser.add_argument("--take-from", type=int, metavar="PORT", help=argparse.SUPPRESS)  # the subscriber's process
    args = parser.parse_args()
    if args.take_from:
        take(args.take_from)
    ways = {
        "nothing": lambda _port, _stack: lambda _seq: None,
        "link": by_link,
        "paho": by_paho,
        "socket": by_socket,
    }
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    with tempfile.TemporaryDirectory() as folder, broker(Path(folder)) as port:
        taker = subprocess.Popen((sys.executable, "-m", "tools.benchmarks.mqtt_message", "--take-from", str(port)))
        try:
            for _ in range(args.rounds):
                for name, way in ways.items():
                    with ExitStack() as stack:
                        found[name].append(measured(way(port, stack), args.seconds))
        finally:
            taker.kill()
    rows = []
    for name, runs in found.items():
        cpu_ms, kept_ms = (float(np.median(values)) for values in zip(*runs, strict=True))
        rows.append([name, f"{cpu_ms:.3f}", f"{kept_ms:.3f}"])
    print(markdown(["way", "CPU ms a frame", "publishing, ms a frame"], rows))


if __name__ == "__main__":
    main()
