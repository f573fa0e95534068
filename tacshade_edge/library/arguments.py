"""Check the arguments of the library's functions; reject wrong ones in one line."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Final

from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import quoted, shown

# Linux's PATH_MAX without the final NUL, and NAME_MAX. A longer path is OSError in whatever opens
# it; here it is an argument that can never work.
_PATH_BYTES_MAX: Final = 4095
_NAME_BYTES_MAX: Final = 255
_TEXT_BYTES_MAX: Final = 65535
"""The longest MQTT string."""


def path_of(name: str, value: object) -> Path:
    """Return an argument as a path that a file can have. Raises ConfigError."""
    if isinstance(value, str | os.PathLike):
        encoded = b""
        with contextlib.suppress(UnicodeEncodeError):
            # Lone surrogates that do not stand for a byte cannot be encoded.
            encoded = os.fsencode(value)
        names = encoded.split(b"/")
        if (
            0 < len(encoded) <= _PATH_BYTES_MAX
            and b"\0" not in encoded
            and max(map(len, names)) <= _NAME_BYTES_MAX
        ):
            return Path(os.fsdecode(encoded))
    raise wrong(name, value, "a path")


def text_of(name: str, value: object, expected: str) -> str:
    """Return an argument as text that MQTT can carry. Raises ConfigError."""
    # MQTT's strings are UTF-8 of at most 65535 bytes, without NUL; paho raises for others late.
    if isinstance(value, str) and "\0" not in value:
        with contextlib.suppress(UnicodeEncodeError):
            if len(value.encode()) <= _TEXT_BYTES_MAX:
                return value
    raise wrong(name, value, expected)


def wrong(name: str, value: object, expected: str) -> ConfigError:
    """The error for an argument of the wrong kind."""
    found = quoted(value) if isinstance(value, str) else shown(repr(value), 60)
    return ConfigError(f"{name}: found {found}, expected {expected}")
