"""Access to a page that is open to a network: only with its token."""

from __future__ import annotations

import hmac
from dataclasses import dataclass
from http import HTTPStatus
from typing import Final

WRONG_MAX: Final = 10
PERIOD_S: Final = 60.0
"""After `WRONG_MAX` wrong tokens from an address in this period (s), the server rejects its tokens unchecked."""

_ADDRESSES_MAX: Final = 256
_COOKIE_S: Final = 30 * 24 * 3600


@dataclass(slots=True)
class _Tries:
    since_s: float
    latest: bytes | None = None
    wrong: int = 0


def offered(authorization: str | None) -> str | None:
    """Return the token of the header ``Authorization: Bearer``; None without one, as with a proxy's own login."""
    scheme, _, token = (authorization or "").partition(" ")
    return token if scheme.lower() == "bearer" else None


class Login:
    """A check of tokens that counts the wrong ones of each address.

    Parameters
    ----------
    token : str
    cookie : str
        Name of the cookie that keeps the token in the browser. It contains the port, since browsers share cookies
        between all ports of a machine.
    secure : bool
        The page is served over TLS, so browsers send the cookie only over TLS.

    Attributes
    ----------
    wrong : int
        Number of wrong tokens so far.
    """

    def __init__(self, token: str, cookie: str, *, secure: bool) -> None:
        self._token = token.encode()
        self._cookie = cookie
        flags = "; Secure" if secure else ""
        self.set_cookie = f"{cookie}={token}; Path=/; Max-Age={_COOKIE_S}; HttpOnly; SameSite=Strict{flags}"
        self._tries: dict[str, _Tries] = {}
        self.wrong = 0

    def kept(self, cookies: str | None) -> str | None:
        """Return the token of a request's header ``Cookie``; None without one."""
        pairs = (pair.strip().partition("=") for pair in (cookies or "").split(";"))
        return next((value for name, _, value in pairs if name == self._cookie), None)

    def refusal(self, offered: str | None, address: str, now_s: float) -> HTTPStatus | None:
        """Return the status that rejects a request; None when it may proceed.

        Repeating a wrong token is no new try: a page that was open when the token changed retries every second.
        """
        tries = self._tries.get(address)
        if tries is not None and now_s - tries.since_s > PERIOD_S:
            del self._tries[address]
            tries = None
        if offered is None:
            return HTTPStatus.UNAUTHORIZED
        if tries is not None and tries.wrong >= WRONG_MAX:
            return HTTPStatus.TOO_MANY_REQUESTS
        guess = offered.encode(errors="surrogateescape")
        if hmac.compare_digest(guess, self._token):
            return None
        if tries is None:
            if len(self._tries) >= _ADDRESSES_MAX:
                del self._tries[next(iter(self._tries))]
            tries = self._tries[address] = _Tries(now_s)
        if guess != tries.latest:
            tries.latest = guess
            tries.wrong += 1
            self.wrong += 1
        return HTTPStatus.UNAUTHORIZED
