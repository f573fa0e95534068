"""Parse a broker's address as people write it."""

from __future__ import annotations

import re
from typing import Final

from ..errors import ConfigError
from ..quoting import quoted

BROKER: Final = "HOST or HOST:PORT, such as localhost:1883"
HOST: Final = r"^(?!.{254})(?:[^\s\x00-\x1f\x7f:/@,?#=\[\]\\]+|(?=.*:.*:)[0-9A-Fa-f:.]+(?:%\w+)?)\Z"
"""Pattern of a host name, an IPv4 address or an IPv6 address, without a scheme,
brackets or a port.
"""
_PORT: Final = "1883"
# Python refuses to convert thousands of digits, with another error.
_PORT_DIGITS_MAX: Final = 5
_PORTS: Final = 65536


def host_and_port(broker: str) -> tuple[str, int]:
    """Split ``HOST`` or ``HOST:PORT``; an IPv6 address is in brackets, the default port is 1883.

    Raises ConfigError.
    """
    # From the right: an IPv6 address has colons too, and must then be in brackets.
    host, colon, port = broker.rpartition(":")
    if not colon:
        host, port = broker, _PORT
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    elif ":" in host:
        host = ""
    # `isdecimal` alone accepts the digits of all scripts, as does `int`.
    sound = port.isascii() and port.isdecimal() and len(port) <= _PORT_DIGITS_MAX
    sound = sound and 0 < int(port) < _PORTS
    # Names that DNS cannot have raise UnicodeError in `getaddrinfo`, deep in paho's thread.
    try:
        sound = sound and bool(re.match(HOST, host) and host.encode("idna"))
    except UnicodeError:
        sound = False
    if not sound:
        raise ConfigError(f"broker: found {quoted(broker)}, expected {BROKER}")
    return host, int(port)
