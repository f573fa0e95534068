"""Parse a broker's address as people write it."""

from __future__ import annotations

from typing import Final

from ..errors import ConfigError
from ..quoting import quoted

BROKER: Final = "HOST or HOST:PORT, such as localhost:1883"
_PORT: Final = "1883"
_HOST_CHARS_MAX: Final = 253


def host_and_port(broker: str) -> tuple[str, int]:
    """Split ``HOST`` or ``HOST:PORT`` into host and port; an IPv6 address is in brackets, the default port is 1883.

    Raises
    ------
    ConfigError
        The host name or the port is not valid.
    """
    host, colon, port = broker.rpartition(":")
    if not colon:
        host, port = broker, _PORT
    sound = port.isascii() and port.isdecimal() and len(port) <= 5 and 0 < int(port) < 65536
    try:
        sound = sound and 0 < len(host) <= _HOST_CHARS_MAX and bool(host.encode("idna"))
    except UnicodeError:
        sound = False
    if not sound:
        raise ConfigError(f"broker: found {quoted(broker)}, expected {BROKER}")
    return host.strip("[]"), int(port)
