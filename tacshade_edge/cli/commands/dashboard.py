"""``tacshade-edge dashboard``: serves the live page from a separate process."""

from __future__ import annotations

import argparse
import asyncio
import signal
import socket
import ssl
import sys
from pathlib import Path
from urllib.parse import urlsplit

from tacshade_edge.cli.shared.addresses import address
from tacshade_edge.cli.shared.dashboard_access import is_loopback, make_token, read_token, server_tls
from tacshade_edge.cli.shared.logs import add_verbosity, start_logging
from tacshade_edge.errors import ConfigError
from tacshade_edge.version import how_to_install

_ANY = ("0.0.0.0", "::")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add_verbosity(parser)
    parser.add_argument(
        "--broker",
        type=address(),
        default=("localhost", 1883),
        metavar="HOST:PORT",
        help="the broker's address and MQTT port, not its WebSocket port (default: localhost:1883)",
    )
    parser.add_argument(
        "--http",
        type=_port,
        default=8080,
        metavar="PORT",
        help="port to serve the page on; 0 picks a free port (default: 8080)",
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help=(
            "address to listen on (default: this machine only); "
            "any other address needs a token and makes the page read-only"
        ),
    )
    parser.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help="file with the token that opens the page read-only; the dashboard creates the file if it is missing",
    )
    parser.add_argument(
        "--allow-control", action="store_true", help="also let anyone with the token send commands to the sensors"
    )
    parser.add_argument(
        "--recordings",
        type=Path,
        metavar="DIR",
        help="let the page list, play, download and delete the recordings in this folder",
    )
    parser.add_argument(
        "--certificate", type=Path, metavar="FILE", help="serve the page over TLS with the certificate in this PEM file"
    )
    parser.add_argument(
        "--key",
        type=Path,
        metavar="FILE",
        help="PEM file with the certificate's private key (default: the --certificate file)",
    )
    parser.add_argument(
        "--ca-file",
        type=Path,
        metavar="FILE",
        help="PEM file with the broker's CA certificate, for a TLS connection to the broker",
    )
    parser.add_argument(
        "--origin",
        type=_origin,
        action="append",
        default=[],
        metavar="URL",
        help="public address of a page that a proxy serves, such as https://hand.example.org",
    )


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or Ctrl-C."""
    try:
        from tacshade_edge.dashboard import server
        from tacshade_edge.dashboard.bridge import Broker
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "websockets":
            raise
        raise ConfigError(
            f"the package websockets is not installed; to install it: {how_to_install('dashboard')}"
        ) from None
    start_logging(args.log_level)
    host, port = args.broker
    broker = Broker(host, port, _tls(args.ca_file) if args.ca_file else None)
    if args.recordings is not None and not args.recordings.is_dir():
        raise ConfigError(f"--recordings {args.recordings}: found no folder, expected a folder with recordings")
    tls = server_tls(args.certificate, args.key)
    is_opened = not is_loopback(args.host)
    token = read_token(args.token_file) if args.token_file else None
    is_new = token is None and (is_opened or args.token_file is not None)
    if is_new:
        token = make_token(args.token_file)
    read_only = token is not None and not args.allow_control

    def listening(host: str, port: int) -> None:
        name = socket.gethostname() if host in _ANY else host
        page = f"{'https' if tls else 'http'}://{f'[{name}]' if ':' in name else name}:{port}/"
        page += f"login#{token}" if is_new else ""
        how = ", read-only" if read_only else ""
        how += f", token in {args.token_file}" if args.token_file else ""
        print(f"dashboard: {page} for the broker {broker}{how}; press Ctrl-C to stop", flush=True)
        if is_opened and not tls:
            print(
                "dashboard: no encryption: others on the network can read the token and the page (see --certificate)",
                file=sys.stderr,
            )

    async def serve() -> None:
        stop = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        await server.run(
            broker,
            args.host,
            args.http,
            frozenset(args.origin),
            listening,
            stop,
            tls=tls,
            token=token,
            read_only=read_only,
            recordings=args.recordings,
        )

    asyncio.run(serve())
    return 0


def _tls(ca_file: Path) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=ca_file)
    except (OSError, ssl.SSLError) as error:
        reason = error.strerror or str(error)
        raise ConfigError(f"--ca-file {ca_file}: {reason}, expected a PEM file with certificates") from error


def _port(text: str) -> int:
    if text.isascii() and text.isdigit() and int(text) <= 65535:
        return int(text)
    raise argparse.ArgumentTypeError(f"found {text!r}, expected a port from 0 to 65535")


def _origin(text: str) -> str:
    parts = urlsplit(text)
    if parts.scheme not in ("http", "https") or not parts.netloc or parts.path.strip("/") or parts.query:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected a page's address such as https://hand.example.org")
    return f"{parts.scheme}://{parts.netloc}".lower()
