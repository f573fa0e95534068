"""Access to the dashboard from other machines: its token and its certificate."""

from __future__ import annotations

import ipaddress
import os
import re
import secrets
import ssl
from pathlib import Path
from typing import Final

from tacshade_edge.errors import ConfigError
from tacshade_edge.regular_files import read_regular

ANY: Final = ("0.0.0.0", "::")
_TOKEN: Final = re.compile(r"[A-Za-z0-9._~-]{16,128}")  # valid in a URL and in a cookie
_TOKEN_BYTES: Final = 24
_FILE_BYTES_MAX: Final = 4096


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address; False for any name except ``localhost``."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def read_token(path: Path) -> str | None:
    """Return the token in a file, or None if there is no file. Raises ConfigError."""
    try:
        text = read_regular(path, _FILE_BYTES_MAX).decode("ascii", "replace").strip()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ConfigError(f"--token-file {path}: {error.strerror}, expected a readable file with the token") from None
    if not _TOKEN.fullmatch(text):
        expected = "expected a line of 16 to 128 letters, digits, '.', '_', '~' or '-'"
        raise ConfigError(f"--token-file {path}: found no valid token, {expected}")
    return text


def make_token(path: Path | None) -> str:
    """Return a new token and, given a path, write it to a new file that only this user can read. Raises ConfigError."""
    token = secrets.token_urlsafe(_TOKEN_BYTES)
    if path is not None:
        try:
            with open(path, "x", opener=lambda name, flags: os.open(name, flags, 0o600)) as stream:
                stream.write(f"{token}\n")
        except OSError as error:
            raise ConfigError(f"--token-file {path}: {error.strerror}, expected a path of a file to make") from None
    return token


def server_tls(certificate: Path | None, key: Path | None) -> ssl.SSLContext | None:
    """Return the TLS context of the server, or None without a certificate. Raises ConfigError."""
    if certificate is None:
        if key is not None:
            raise ConfigError(f"--key {key}: found no --certificate, expected both options")
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        # Without this password, OpenSSL would prompt for one at the terminal if the key is encrypted.
        context.load_cert_chain(certificate, key, password=lambda: "")
    except OSError as error:
        shown = f"--certificate {certificate}" + (f" --key {key}" if key else "")
        expected = "expected PEM files with a certificate and its own unencrypted key"
        raise ConfigError(f"{shown}: {error.strerror or error}, {expected}") from None
    return context
