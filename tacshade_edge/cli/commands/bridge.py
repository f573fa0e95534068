"""``tacshade-edge bridge``: serves what sensors publish to other tools, in a separate process."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Callable

from tacshade_edge.cli.shared.addresses import address
from tacshade_edge.cli.shared.dashboard_access import is_loopback
from tacshade_edge.cli.shared.logs import add_verbosity, start_logging
from tacshade_edge.devices.mqtt.client import BrokerAddress
from tacshade_edge.devices.mqtt.follower import Follower
from tacshade_edge.errors import ConfigError
from tacshade_edge.factories.links import password_in
from tacshade_edge.version import how_to_install

POLL_S = 0.1
_ENDS = (signal.SIGTERM, signal.SIGINT)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)
    for name, port, text in (
        ("foxglove", 8765, "serve live data to Foxglove and Lichtblick over their WebSocket protocol"),
        ("prometheus", 9469, "serve every sensor's health as Prometheus metrics on /metrics"),
    ):
        kind = kinds.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        kind.add_argument(
            "--broker",
            type=address(1883),
            default=("localhost", 1883),
            metavar="HOST[:PORT]",
            help="the broker's address (default: localhost:1883)",
        )
        kind.add_argument(
            "--sensor", nargs="+", default=[], metavar="ID", help="serve only these sensors (default: all)"
        )
        kind.add_argument(
            "--listen",
            type=address(port),
            default=("127.0.0.1", port),
            metavar="HOST[:PORT]",
            help=f"address and port to listen on; 0 picks a free port (default: 127.0.0.1:{port}, this machine only)",
        )
        kind.add_argument("--username", metavar="NAME", help="user name for the broker")
        kind.add_argument("--password-file", metavar="FILE", help="file whose first line is the broker password")
        kind.add_argument(
            "--ca-file",
            metavar="FILE",
            help="PEM file with the broker's CA certificate, for a TLS connection to the broker",
        )
        add_verbosity(kind)


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or Ctrl-C."""
    if args.password_file and not args.username:
        raise ConfigError("--password-file: found no --username, expected both options")
    host, port = args.broker
    broker = BrokerAddress(
        host=host,
        port=port,
        username=args.username,
        password=password_in(args.password_file, "--password-file") if args.password_file else None,
        tls_ca=args.ca_file,
    )
    # `_serve` waits for the blocked signals, so no handler interrupts other code. Threads started later inherit the
    # mask; one that a library started before may take a signal, which must not end the process: hence the handlers.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDS)
    ended = threading.Event()
    handlers = {number: signal.signal(number, lambda *_: ended.set()) for number in _ENDS}
    try:
        start_logging(args.log_level)
        {"foxglove": _foxglove, "prometheus": _prometheus}[args.kind](args, broker, ended)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return 0


def _foxglove(args: argparse.Namespace, broker: BrokerAddress, ended: threading.Event) -> None:
    try:
        from tacshade_edge.bridge.foxglove import FoxgloveBridge
    except ModuleNotFoundError as error:
        raise _missing(error, "foxglove", "foxglove-sdk") from None
    host, port = args.listen
    follower = Follower(broker, lambda *message: bridge.hear(*message))
    bridge = FoxgloveBridge(host, port, args.sensor, follower.follow)
    _announce(args, f"ws://{_in_url(host)}:{bridge.port}")
    try:
        _serve(follower, bridge.poll, ended)
    finally:
        bridge.stop()


def _prometheus(args: argparse.Namespace, broker: BrokerAddress, ended: threading.Event) -> None:
    try:
        from prometheus_client import CollectorRegistry

        from tacshade_edge.bridge.prometheus import MetricsServer, SensorMetrics
    except ModuleNotFoundError as error:
        raise _missing(error, "prometheus", "prometheus_client") from None
    host, port = args.listen
    sensors = SensorMetrics(args.sensor)
    registry = CollectorRegistry()
    registry.register(sensors)
    follower = Follower(broker, sensors.hear)
    follower.follow(sensors.topics)
    try:
        server = MetricsServer(host, port, registry)
    except OSError as error:
        reason = error.strerror or error
        raise ConfigError(
            f"--listen {host}:{port}: {reason}, expected a free port on one of this machine's addresses"
        ) from None
    _announce(args, f"http://{_in_url(host)}:{server.server_port}/metrics")
    try:
        _serve(follower, lambda: None, ended)
    finally:
        server.stop()


def _serve(follower: Follower, poll: Callable[[], None], ended: threading.Event) -> None:
    crashes: list[BaseException] = []
    threading.excepthook = lambda hook: crashes.append(hook.exc_value or RuntimeError(hook.exc_type.__name__))
    follower.start()
    try:
        while signal.sigtimedwait(_ENDS, POLL_S) is None and not ended.is_set():
            if crashes:
                raise crashes[0]
            poll()
    finally:
        follower.stop()


def _announce(args: argparse.Namespace, url: str) -> None:
    host, port = args.broker
    print(f"{args.kind}: {url} for the broker {host}:{port}; press Ctrl-C to stop", flush=True)
    if not is_loopback(args.listen[0]):
        print(f"{args.kind}: no encryption and no password: anyone on the network can read it", file=sys.stderr)


def _missing(error: ModuleNotFoundError, extra: str, package: str) -> Exception:
    if error.name is None or error.name.partition(".")[0] not in ("foxglove", "prometheus_client", "websockets"):
        return error
    return ConfigError(f"the package {package} is not installed; to install it: {how_to_install(extra)}")


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host
