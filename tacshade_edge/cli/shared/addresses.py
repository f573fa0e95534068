"""Network addresses as command-line options."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from urllib.parse import urlsplit


def address(default_port: int | None = None) -> Callable[[str], tuple[str, int]]:
    """Return an argparse type that reads HOST:PORT; with a default port, it also accepts HOST alone and port 0."""

    def read(text: str) -> tuple[str, int]:
        try:
            parts = urlsplit(f"//{text}")
            host, port = parts.hostname, parts.port
        except ValueError:
            host = port = None
        if host and parts.netloc == text and parts.username is None and not text.endswith(":"):
            if default_port is not None:
                return host, default_port if port is None else port
            if port:
                return host, port
        expected = "HOST:PORT" if default_port is None else "HOST or HOST:PORT"
        raise argparse.ArgumentTypeError(
            f"found {text!r}, expected {expected} such as localhost:{default_port or 1883}"
        )

    return read
