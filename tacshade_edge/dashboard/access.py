"""Which pages may open the WebSocket: such a page can command the hand."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Collection
from urllib.parse import urlsplit


def refusal(origin: str | None, host: str | None, allowed_origins: Collection[str]) -> str:
    """Return why a WebSocket request is rejected; empty when it may proceed.

    Any web site open in the user's browser can try to connect to this server; the browser states the site's address as
    `origin`. It must match ours: the `host` that the browser connected to. A site can also point its own name at our
    address (DNS rebinding), and then both agree: so a name must be one that nobody else can own.

    Parameters
    ----------
    origin : str or None
        The header ``Origin``; None from a program other than a browser, which needs no such trick.
    host : str or None
        The header ``Host``.
    allowed_origins : collection of str
        Origins of further pages, such as ``https://hand.example.org`` of a reverse proxy.
    """
    if origin is None or origin.lower() in allowed_origins:
        return ""
    if host is None or origin.lower() not in (f"http://{host.lower()}", f"https://{host.lower()}"):
        return f"found a page from {origin[:80]}, expected one from here; behind a proxy, pass --origin {origin[:80]}"
    name = urlsplit(f"//{host}").hostname or ""
    if name != "localhost" and not _is_address(name) and name not in _own_names():
        return f"found the host {name[:80]}, expected this machine; if it is this one, pass --origin {origin[:80]}"
    return ""


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _own_names() -> set[str]:
    own = socket.gethostname().lower()
    return {own, f"{own.partition('.')[0]}.local"}
