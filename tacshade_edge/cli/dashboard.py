"""``tacshade-edge dashboard``: the live page, in a process of its own."""

from __future__ import annotations

import argparse
import asyncio
import ipaddress
import signal
import ssl
import sys
from pathlib import Path
from urllib.parse import urlsplit

from tacshade_edge.cli.logs import start_logging
from tacshade_edge.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--broker",
        type=_host_and_port,
        default=("localhost", 1883),
        metavar="HOST:PORT",
        help="the broker's plain MQTT port (default: localhost:1883)",
    )
    parser.add_argument(
        "--http", type=_port, default=8080, metavar="PORT", help="port of the page; 0: any free one (default: 8080)"
    )
    parser.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="address to listen on (default: this machine only)"
    )
    parser.add_argument("--ca-file", type=Path, metavar="FILE", help="PEM file of the broker's CA: use TLS to it")
    parser.add_argument(
        "--origin",
        type=_origin,
        action="append",
        default=[],
        metavar="URL",
        help="where the page is opened when a proxy stands in front, such as https://hand.example.org",
    )


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or Ctrl-C."""
    try:
        from tacshade_edge.dashboard import server
        from tacshade_edge.dashboard.bridge import Broker
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "websockets":
            raise
        raise ConfigError("the package websockets is missing: pip install 'tacshade-edge[dashboard]'") from None
    start_logging()
    host, port = args.broker
    broker = Broker(host, port, _tls(args.ca_file) if args.ca_file else None)

    def listening(host: str, port: int) -> None:
        shown = f"[{host}]" if ":" in host else host
        print(f"dashboard: http://{shown}:{port}/ for the broker {broker}; Ctrl-C ends", flush=True)
        if not ipaddress.ip_address(host).is_loopback:
            print(
                "dashboard: other machines can open this page, unencrypted; a broker without passwords then "
                "obeys anybody",
                file=sys.stderr,
            )

    async def serve() -> None:
        stop = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        await server.run(broker, args.host, args.http, frozenset(args.origin), listening, stop)

    asyncio.run(serve())
    return 0


def _tls(ca_file: Path) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=ca_file)
    except (OSError, ssl.SSLError) as error:
        reason = error.strerror or str(error)
        raise ConfigError(f"--ca-file {ca_file}: {reason}, expected a PEM file of certificates") from error


def _port(text: str) -> int:
    if text.isascii() and text.isdigit() and int(text) <= 65535:
        return int(text)
    raise argparse.ArgumentTypeError(f"found {text!r}, expected a port from 0 to 65535")


def _host_and_port(text: str) -> tuple[str, int]:
    try:
        parts = urlsplit(f"//{text}")
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port or parts.netloc != text or parts.username is not None:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected HOST:PORT such as localhost:1883")
    return host, port


def _origin(text: str) -> str:
    parts = urlsplit(text)
    if parts.scheme not in ("http", "https") or not parts.netloc or parts.path.strip("/") or parts.query:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected a page's address such as https://hand.example.org")
    return f"{parts.scheme}://{parts.netloc}".lower()
