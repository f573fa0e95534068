"""Measure what TLS costs a height map from publish to decode, through a mosquitto with the shipped drop-in.

::

    .venv/bin/python -m tools.benchmarks.tls [--messages 150] [--rate 30] [--bytes 38000] [--json FILE]

The publisher is the daemon's own MQTT client; the subscriber is another one in its own thread. The last rows remove
what makes it fast: ``set_tcp_nodelay`` in the drop-in, TCP_NODELAY on the daemon's socket, and both.
"""

from __future__ import annotations

import argparse
import json
import ssl
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from tacshade_edge.devices.mqtt.client import BrokerAddress, connect, make_client
from tools.testbed.daemon_rig import broker

DROP_IN = Path(__file__).parents[2] / "systemd/mosquitto-tacshade.conf"
HOST, TOPIC, WARM_UP = "127.0.0.1", "tacshade/bench/height", 10
# Name, TLS, set_tcp_nodelay, the client's TCP_NODELAY.
CASES = (
    ("TCP", False, True, True),
    ("TLS", True, True, True),
    ("TLS, broker without nodelay", True, False, True),
    ("TLS, client without nodelay", True, True, False),
    ("TLS, both without", True, False, False),
)


def settings(folder: Path, tls: bool, nodelay: bool) -> tuple[str, str]:
    """The drop-in and the listener's settings."""
    drop_in = DROP_IN.read_text()
    assert "\nset_tcp_nodelay true\n" in drop_in
    if not nodelay:
        drop_in = drop_in.replace("\nset_tcp_nodelay true\n", "\n")
    return drop_in, f"certfile {folder / 'cert.pem'}\nkeyfile {folder / 'key.pem'}\n" if tls else ""


def make_certificate(folder: Path) -> None:
    """Make a certificate for the loopback address, valid for two days."""
    options = "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=localhost"
    names = ["-addext", f"subjectAltName=IP:{HOST}", "-keyout", str(folder / "key.pem"), "-out"]
    subprocess.run(["openssl", *options.split(), *names, str(folder / "cert.pem")], check=True, capture_output=True)


def latencies_ms(port: int, ca: Path | None, nodelay: bool, args: argparse.Namespace) -> list[float]:
    """Latencies in ms from before `publish` to the subscriber's callback, sorted, without the first few."""
    found: list[float] = []
    subscribed, all_there = threading.Event(), threading.Event()

    def on_message(_client: Client, _data: None, message: MQTTMessage) -> None:
        found.append((time.monotonic_ns() - struct.unpack_from("<q", message.payload)[0]) / 1e6)
        if len(found) == WARM_UP + args.messages:
            all_there.set()

    subscriber = Client(CallbackAPIVersion.VERSION2)
    if ca is not None:
        subscriber.tls_set(str(ca), cert_reqs=ssl.CERT_REQUIRED)
    subscriber.on_message = on_message
    subscriber.on_subscribe = lambda *_: subscribed.set()
    subscriber.connect(HOST, port)
    subscriber.subscribe(TOPIC)
    subscriber.loop_start()
    address = BrokerAddress(host=HOST, port=port, username=None, password=None, tls_ca=str(ca) if ca else None)
    publisher = make_client(address, base_topic="tacshade/bench", client_id="bench")
    if not nodelay:
        publisher.on_socket_open = None
    ready = threading.Event()
    publisher.on_connect = lambda *_: ready.set()
    connect(publisher, HOST, port)
    try:
        if not (subscribed.wait(10) and ready.wait(10)):
            raise SystemExit("tls: found no connection")
        due_s = time.monotonic()
        rest = bytes(args.bytes - 8)
        for _ in range(WARM_UP + args.messages):
            publisher.publish(TOPIC, struct.pack("<q", time.monotonic_ns()) + rest)
            due_s += 1 / args.rate
            time.sleep(max(0.0, due_s - time.monotonic()))
        if not all_there.wait(10):
            raise SystemExit(f"tls: {len(found)} of {WARM_UP + args.messages} messages arrived")
    finally:
        for client in (publisher, subscriber):
            client.disconnect()
            client.loop_stop()
    return sorted(found[WARM_UP:])


def main() -> int:
    """Measure all cases and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--messages", type=int, default=150, help="of each case")
    parser.add_argument("--rate", type=float, default=30.0, help="messages per second")
    parser.add_argument("--bytes", type=int, default=38000, help="of each message")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    args = parser.parse_args()
    figures: dict[str, dict[str, float]] = {}
    print(f"{'':30}{'p50 ms':>9}{'p99 ms':>9}")
    for name, tls, broker_nodelay, client_nodelay in CASES:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            make_certificate(folder)
            with broker(folder, *settings(folder, tls, broker_nodelay)) as port:
                ms = latencies_ms(port, folder / "cert.pem" if tls else None, client_nodelay, args)
        figures[name] = {"p50": round(ms[len(ms) // 2], 2), "p99": round(ms[int(len(ms) * 0.99)], 2)}
        print(f"{name:30}{figures[name]['p50']:>9}{figures[name]['p99']:>9}", flush=True)
    if args.json:
        args.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
