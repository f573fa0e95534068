"""Who may see the page, with its token if it is open to a network,
and which pages may open the WebSocket.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Collection
from dataclasses import dataclass
from http import HTTPStatus
from typing import Final
from urllib.parse import urlsplit

WRONG_MAX: Final = 10
PERIOD_S: Final = 60.0
"""After `WRONG_MAX` wrong tokens from an address in this period (s), the server answers its further
wrong ones with 429. The right one always passes: others at that address cannot lock anyone out.
"""

# The table forgets its oldest entry: whoever has many addresses, as with IPv6, must not fill the
# memory of a board.
_ADDRESSES_MAX: Final = 256
_BROWSER_BYTES: Final = 16
_COOKIE_S: Final = 30 * 24 * 3600


def refusal(origin: str | None, host: str | None, allowed_origins: Collection[str]) -> str:
    """Return why a WebSocket request is rejected; empty when it may proceed.

    Any web site open in the user's browser can try to connect; the browser states the site's
    address as `origin` (None: another program). It must be the `host` that the browser connected
    to, or one of `allowed_origins`, a proxy's. As a site can point its own name at our address (DNS
    rebinding), a host's name must be one that nobody else can own.
    """
    # A program that is no browser can state any origin, so demanding one would stop nobody.
    if origin is None or origin.lower() in allowed_origins:
        return ""
    if host is None or origin.lower() not in (f"http://{host.lower()}", f"https://{host.lower()}"):
        return (
            f"found a page from {origin[:80]}, expected one from here; behind a proxy, pass "
            f"--origin {origin[:80]}"
        )
    name = urlsplit(f"//{host}").hostname or ""
    if not _is_own(name):
        return (
            f"found the host {name[:80]}, expected this machine; if it is this one, pass --origin "
            f"{origin[:80]}"
        )
    return ""


def _is_own(name: str) -> bool:
    """Whether a host's name is an address, or a name of this machine."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        # .local is multicast DNS: whoever can forge it is on this network already.
        own = socket.gethostname().lower()
        return name in ("localhost", own, f"{own.partition('.')[0]}.local")
    return True


@dataclass(slots=True)
class _Tries:
    since_s: float
    latest: bytes | None = None
    wrong: int = 0


def offered(authorization: str | None) -> str | None:
    """Return the token of the header ``Authorization: Bearer``;
    None without one, as with a proxy's own login.
    """
    scheme, _, token = (authorization or "").partition(" ")
    return token if scheme.lower() == "bearer" else None


class Login:
    """A check of tokens that counts the wrong ones of each address;
    a `secure` cookie is sent only over TLS, and then also from a frame in another site's page, if
    it may be `framed`: browsers keep it for frames in that site alone.
    """

    def __init__(self, token: str, cookie: str, *, secure: bool, framed: bool = False) -> None:
        self._token = token.encode()
        self._cookie = cookie
        self._flags = "SameSite=Strict; Secure" if secure else "SameSite=Strict"
        if secure and framed:
            self._flags = "SameSite=None; Secure; Partitioned"
        self._tries: dict[str, _Tries] = {}
        self.wrong = 0

    def set_cookie(self) -> str:
        """Return the header ``Set-Cookie`` for a browser that has logged in."""
        # Each browser has a name, signed with the token: a new token ends every login, without a
        # list of sessions.
        browser = secrets.token_urlsafe(_BROWSER_BYTES)
        value = f"{browser}.{self._signed(browser)}"
        return f"{self._cookie}={value}; Path=/; Max-Age={_COOKIE_S}; HttpOnly; {self._flags}"

    def _signed(self, browser: str) -> str:
        # surrogateescape: a header may hold bytes that are no text, and must not raise.
        return hmac.digest(self._token, browser.encode(errors="surrogateescape"), "sha256").hex()

    def kept(self, cookies: str | None) -> str | None:
        """Return the value of our cookie in a request's header ``Cookie``; None without one."""
        pairs = (pair.strip().partition("=") for pair in (cookies or "").split(";"))
        return next((value for name, _, value in pairs if name == self._cookie), None)

    def refusal(
        self, token: str | None, kept: str | None, address: str, now_s: float
    ) -> HTTPStatus | None:
        """Return the status that rejects a request with a token or else a cookie;
        None when it may proceed.

        Repeating a wrong token is no new try: a page that was open
        when the token changed retries every second.
        """
        tries = self._tries.get(address)
        if tries is not None and now_s - tries.since_s > PERIOD_S:
            del self._tries[address]
            tries = None
        if token is None and kept is None:
            return HTTPStatus.UNAUTHORIZED
        browser, _, signature = (kept or "").rpartition(".")
        offered, expected = (
            (signature, self._signed(browser).encode()) if token is None else (token, self._token)
        )
        guess = offered.encode(errors="surrogateescape")
        # In constant time: the first wrong byte must not show in how long it takes.
        if hmac.compare_digest(guess, expected):
            return None
        if tries is None:
            if len(self._tries) >= _ADDRESSES_MAX:
                del self._tries[next(iter(self._tries))]
            tries = self._tries[address] = _Tries(now_s)
        is_locked_out = tries.wrong >= WRONG_MAX
        if guess != tries.latest:
            tries.latest = guess
            tries.wrong += 1
            self.wrong += 1
        return HTTPStatus.TOO_MANY_REQUESTS if is_locked_out else HTTPStatus.UNAUTHORIZED
