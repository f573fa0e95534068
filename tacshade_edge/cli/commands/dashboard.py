"""``tacshade-edge dashboard``: serves the live page from a separate process."""

from __future__ import annotations

import argparse
import asyncio
import ipaddress
import os
import re
import secrets
import signal
import socket
import ssl
import sys
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from tacshade_edge.cli.shared.logs import add_verbosity, start_logging
from tacshade_edge.cli.shared.options import PORT, add_flag, add_option, address, need
from tacshade_edge.errors import ConfigError
from tacshade_edge.regular_files import decoded, read_regular

ANY: Final = ("0.0.0.0", "::")
# What is valid both in a URL and in a cookie, which the page makes of it.
_TOKEN: Final = re.compile(r"[A-Za-z0-9._~-]{16,128}")
_TOKEN_BYTES: Final = 24
_FILE_BYTES_MAX: Final = 4096


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_verbosity(parser)
    text = "the broker's MQTT address (default: localhost:1883)"
    add_option(parser, "--broker", "HOST:PORT", text, address(), default=("localhost", 1883))
    add_option(
        parser,
        "--http",
        "PORT",
        "port of the page; 0: any free one (default: 8080)",
        PORT,
        default=8080,
    )
    text = "address to listen on (default: this machine only); any other is read-only"
    add_option(parser, "--host", "ADDRESS", text, str, default="127.0.0.1")
    add_option(
        parser,
        "--token-file",
        "FILE",
        "file with the token that opens the page; made if it is missing",
    )
    add_flag(parser, "--allow-control", "also let anyone with the token command the sensors")
    add_option(
        parser, "--recordings", "DIR", "let the page play, download and delete the recordings here"
    )
    add_option(
        parser,
        "--certificate",
        "FILE",
        "serve the page over TLS with the certificate in this PEM file",
    )
    add_option(
        parser,
        "--key",
        "FILE",
        "PEM file with the certificate's private key (default: the --certificate file)",
    )
    add_option(
        parser,
        "--ca-file",
        "FILE",
        "PEM file with the CA certificate, for a TLS connection to the broker",
    )
    text = "address of the page at a proxy: https://hand.example.org"
    add_option(parser, "--origin", "URL", text, _origin, action="append", default=[])
    text = "address of a page that may show this one in a frame: http://homeassistant.local:8123"
    add_option(parser, "--embed-in", "URL", text, _origin, action="append", default=[])


def run(args: argparse.Namespace) -> int:
    need("dashboard", "dashboard", "websockets")
    from tacshade_edge.dashboard import server
    from tacshade_edge.dashboard.relay import Broker

    start_logging(args.log_level)
    host, port = args.broker
    broker = Broker(host, port, _tls(args.ca_file) if args.ca_file else None)
    # Everything that can be wrong is found before the port is opened.
    if args.recordings is not None:
        _make_folder(args.recordings)
    tls = server_tls(args.certificate, args.key)
    is_opened = not is_loopback(args.host)
    token, is_new = _token(args.token_file, is_opened=is_opened)
    read_only = token is not None and not args.allow_control

    def listening(host: str, port: int) -> None:
        name = socket.gethostname() if host in ANY else host
        scheme = "https" if tls else "http"
        # After the #, which browsers send to nobody: no proxy and no log sees the token.
        path = f"login#{token}" if is_new else ""
        page = f"{scheme}://{in_url(name)}:{port}/{path}"
        how = ", read-only" if read_only else ""
        how += f", token in {args.token_file}" if args.token_file else ""
        print(f"dashboard: {page} for the broker {broker}{how}; press Ctrl-C to stop", flush=True)
        if is_opened and not tls:
            text = (
                "no encryption: others on the network can read the token and the page (see "
                "--certificate)"
            )
            print(f"dashboard: {text}", file=sys.stderr)

    async def serve() -> None:
        stop = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            # In the loop's thread: a signal's own handler may not touch an Event.
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        access = {"tls": tls, "token": token, "read_only": read_only, "recordings": args.recordings}
        access["embed_in"] = frozenset(args.embed_in)
        await server.run(
            broker, args.host, args.http, frozenset(args.origin), listening, stop, **access
        )

    asyncio.run(serve())
    return 0


def _make_folder(path: Path) -> None:
    """Make the folder of the recordings, which the daemon makes only with the first of them."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"--recordings {path}: {error.strerror}, expected a folder with recordings, or a path "
            "where this user can make one"
        ) from None


def _token(file: Path | None, *, is_opened: bool) -> tuple[str | None, bool]:
    """The token that opens the page, None without one, and whether it is new.

    Raises ConfigError.
    """
    token = read_token(file) if file else None
    # Anyone may open the page on the machine itself; elsewhere only who has a token.
    is_new = token is None and (is_opened or file is not None)
    return make_token(file) if is_new else token, is_new


def _tls(ca_file: Path) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=ca_file)
    except (OSError, ssl.SSLError) as error:
        reason = error.strerror or str(error)
        raise ConfigError(
            f"--ca-file {ca_file}: {reason}, expected a PEM file with certificates"
        ) from error


def _origin(text: str) -> str:
    parts = urlsplit(text)
    if (
        parts.scheme not in ("http", "https")
        or not parts.netloc
        or parts.path.strip("/")
        or parts.query
    ):
        raise argparse.ArgumentTypeError(
            f"found {text!r}, expected a page's address such as https://hand.example.org"
        )
    # As browsers send it: in lower case, without a path.
    return f"{parts.scheme}://{parts.netloc}".lower()


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address; False for any name except ``localhost``."""
    try:
        # Another name may resolve to any address, tomorrow to another one.
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def read_token(path: Path) -> str | None:
    """Return the token in a file, or None if there is no file. Raises ConfigError."""
    try:
        text = decoded(read_regular(path, _FILE_BYTES_MAX)).strip()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ConfigError(
            f"--token-file {path}: {error.strerror}, expected a readable file with the token"
        ) from None
    except UnicodeDecodeError:
        text = ""
    if not _TOKEN.fullmatch(text):
        expected = "expected a line of 16 to 128 letters, digits, '.', '_', '~' or '-'"
        raise ConfigError(f"--token-file {path}: found no valid token, {expected}")
    return text


def make_token(path: Path | None) -> str:
    """Return a new token and, given a path, write it to a new file that only this user can read.

    Raises ConfigError.
    """
    token = secrets.token_urlsafe(_TOKEN_BYTES)
    if path is not None:
        try:
            # Made with its final permissions: between making it and changing them, others could
            # open it.
            with open(path, "x", opener=lambda name, flags: os.open(name, flags, 0o600)) as stream:
                stream.write(f"{token}\n")
        except OSError as error:
            raise ConfigError(
                f"--token-file {path}: {error.strerror}, expected a path of a file to make"
            ) from None
    return token


def server_tls(certificate: Path | None, key: Path | None) -> ssl.SSLContext | None:
    """Return the TLS context of the server, or None without a certificate. Raises ConfigError."""
    if certificate is None:
        if key is not None:
            raise ConfigError(f"--key {key}: found no --certificate, expected both options")
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        # Without this password, OpenSSL would prompt for one at the terminal
        # if the key is encrypted.
        context.load_cert_chain(certificate, key, password=lambda: "")
    except OSError as error:
        shown = f"--certificate {certificate}" + (f" --key {key}" if key else "")
        expected = "expected PEM files with a certificate and its own unencrypted key"
        raise ConfigError(f"{shown}: {error.strerror or error}, {expected}") from None
    return context
