"""``tacshade-edge bridge``: serves what sensors publish to other tools, in a separate process."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from tacshade_edge.bridge.expected_sensors import ExpectedSensors
from tacshade_edge.cli.commands.dashboard import in_url, is_loopback
from tacshade_edge.cli.shared.logs import add_verbosity, start_logging
from tacshade_edge.cli.shared.options import add_flag, add_option, address, need, number
from tacshade_edge.errors import ConfigError
from tacshade_edge.mqtt.client import BrokerAddress
from tacshade_edge.mqtt.follower import Follower
from tacshade_edge.mqtt.links import password_in

POLL_S = 0.1
ROUTER_PORT = 7447
# The highest domain that every middleware of ROS 2 has.
DOMAIN_MAX = 232
_DOMAIN_TEXT = f"a whole number from 0 to {DOMAIN_MAX}"
_DOMAIN = number(_DOMAIN_TEXT, 0, DOMAIN_MAX, int)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)
    for name, port, text in (
        (
            "foxglove",
            8765,
            "serve live data to Foxglove and Lichtblick over their WebSocket protocol",
        ),
        ("prometheus", 9469, "serve every sensor's health as Prometheus metrics on /metrics"),
    ):
        kind = _kind(kinds, name, text)
        listen = (
            f"address and port to listen on; 0 picks a free port (default: 127.0.0.1:{port}, "
            "this machine only)"
        )
        add_option(
            kind, "--listen", "HOST[:PORT]", listen, address(port), default=("127.0.0.1", port)
        )
        if name == "prometheus":
            text = "serve contacts too, which makes the sensors compute every frame"
            add_flag(kind, "--contact", text)
    text = "show sensors to ROS 2 (Jazzy or later) with rmw_zenoh; nothing of ROS is needed here"
    _add_ros2(_kind(kinds, "ros2", text))


def _kind(kinds: Any, name: str, text: str) -> argparse.ArgumentParser:
    """Declare a kind of bridge with the options of all kinds."""
    kind: argparse.ArgumentParser = kinds.add_parser(
        name, help=text, description=text[0].upper() + text[1:] + "."
    )
    broker = "the broker's address (default: localhost:1883)"
    add_option(kind, "--broker", "HOST[:PORT]", broker, address(1883), default=("localhost", 1883))
    add_option(
        kind,
        "--sensor",
        "ID",
        "serve only these sensors (default: all)",
        str,
        nargs="+",
        default=[],
    )
    add_option(kind, "--username", "NAME", "user name for the broker", str)
    add_option(kind, "--password-file", "FILE", "file whose first line is the broker password")
    text = "PEM file with the CA certificate, for TLS to the broker"
    add_option(kind, "--ca-file", "FILE", text, str)
    add_verbosity(kind)
    return kind


def _add_ros2(kind: argparse.ArgumentParser) -> None:
    port = ROUTER_PORT
    text = f"the Zenoh router's address (default: localhost:{port})"
    add_option(kind, "--router", "HOST[:PORT]", text, address(port), default=("localhost", port))
    text = "ROS 2's domain (default: $ROS_DOMAIN_ID, else 0)"
    add_option(kind, "--domain", "N", text, _DOMAIN)


def run(args: argparse.Namespace) -> int:
    if args.password_file and not args.username:
        raise ConfigError("--password-file: found no --username, expected both options")
    host, port = args.broker
    password = password_in(args.password_file, "--password-file") if args.password_file else None
    broker = BrokerAddress(
        host=host, port=port, username=args.username, password=password, tls_ca=args.ca_file
    )
    start_logging(args.log_level)
    {"foxglove": _foxglove, "prometheus": _prometheus, "ros2": _ros2}[args.kind](args, broker)
    return 0


def _foxglove(args: argparse.Namespace, broker: BrokerAddress) -> None:
    need("bridge", "foxglove", "foxglove", "websockets")
    from tacshade_edge.bridge.foxglove import FoxgloveBridge

    host, port = args.listen
    # The bridge and its follower need each other: when a message comes, `bridge` is there.
    follower = Follower(broker, lambda *message: bridge.hear(*message))
    with _listening(args):
        # Listens as it is made, before the broker is there to be followed.
        bridge = FoxgloveBridge(host, port, args.sensor, follower.follow)
    try:
        _serve(args, broker, f"ws://{in_url(host)}:{bridge.port}", follower, bridge.poll)
    finally:
        bridge.stop()


def _prometheus(args: argparse.Namespace, broker: BrokerAddress) -> None:
    need("bridge", "prometheus", "prometheus_client")
    from prometheus_client import CollectorRegistry

    from tacshade_edge.bridge.prometheus import MetricsServer, SensorMetrics

    host, port = args.listen
    sensors = SensorMetrics(args.sensor, contact=args.contact)
    registry = CollectorRegistry()
    registry.register(sensors)
    follower = Follower(broker, sensors.hear)
    follower.follow(sensors.topics)
    with _listening(args):
        server = MetricsServer(host, port, registry)
    try:
        _serve(
            args,
            broker,
            f"http://{in_url(host)}:{server.server_port}/metrics",
            follower,
            lambda: None,
        )
    finally:
        server.stop()


def _ros2(args: argparse.Namespace, broker: BrokerAddress) -> None:
    need("bridge", "ros2", "zenoh", "xxhash")
    from tacshade_edge.bridge.ros2 import Ros2Bridge

    host, port = args.router
    router = f"tcp/{in_url(host)}:{port}"
    domain = _domain() if args.domain is None else args.domain
    # The bridge and its follower need each other, as above.
    follower = Follower(
        broker, lambda topic, payload, kept: bridge.hear(topic, payload, is_retained=kept)
    )
    bridge = Ros2Bridge(router, domain, args.sensor, follower.follow)
    try:
        _serve(args, broker, f"domain {domain} through the router {router}", follower, bridge.poll)
    finally:
        bridge.stop()


def _domain() -> int:
    """ROS's domain as its other programs get it."""
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    try:
        return int(_DOMAIN(text))
    except argparse.ArgumentTypeError as error:
        raise ConfigError(f"ROS_DOMAIN_ID: {error}") from None


@contextmanager
def _listening(args: argparse.Namespace) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        host, port = args.listen
        expected = "expected a free port on one of this machine's addresses"
        raise ConfigError(
            f"--listen {host}:{port}: {error.strerror or error}, {expected}"
        ) from None


def _serve(
    args: argparse.Namespace,
    broker: BrokerAddress,
    where: str,
    follower: Follower,
    poll: Callable[[], None],
) -> None:
    ended: list[int] = []
    crashes: list[BaseException] = []
    for caught in (signal.SIGTERM, signal.SIGINT):
        signal.signal(caught, lambda caught, _: ended.append(caught))
    # An error that nobody catches in paho's thread ends the process, as it does a daemon; the main
    # thread raises it, so that its traceback is the last thing on stderr.
    threading.excepthook = lambda hook: crashes.append(
        hook.exc_value or RuntimeError(hook.exc_type.__name__)
    )
    host, port = args.broker
    print(f"{args.kind}: {where} for the broker {host}:{port}; press Ctrl-C to stop", flush=True)
    # Said at each start: neither server asks who reads, and no router of ROS either.
    if not is_loopback(args.router[0] if args.kind == "ros2" else args.listen[0]):
        print(
            f"{args.kind}: no encryption and no password: anyone on the network can read it",
            file=sys.stderr,
        )
    follower.start()
    expected = ExpectedSensors(broker, args.sensor)
    try:
        while not ended:
            if crashes:
                raise crashes[0]
            poll()
            expected.poll()
            time.sleep(POLL_S)
    finally:
        expected.stop()
        follower.stop()
