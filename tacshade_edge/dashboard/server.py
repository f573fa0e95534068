"""One port: the page's files over HTTP, ``/mqtt`` and ``/recordings`` over WebSocket;
all of it is bounded.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import time
from collections.abc import Callable, Collection, Mapping
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final, Protocol, cast
from urllib.parse import unquote

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from tacshade_edge.dashboard import access
from tacshade_edge.dashboard.access import Login
from tacshade_edge.dashboard.downloads import RETRY_S, BusyError, Downloads
from tacshade_edge.dashboard.page_files import File, load, security_headers
from tacshade_edge.dashboard.recordings import RecordingCommands
from tacshade_edge.dashboard.relay import FROM_PAGE_BYTES_MAX, Bridge, Broker
from tacshade_edge.errors import DeviceError
from tacshade_edge.listening_socket import Connections, ListeningSocket
from tacshade_edge.quoting import escaped

_log = logging.getLogger(__name__)

# A browser opens up to six connections for the files of one page, and a WebSocket.
CONNECTIONS_MAX: Final = 48
"""Pages, file requests and connections that have sent nothing yet;
the server closes any further one at once.
"""
PAGES_MAX: Final = 16
"""WebSockets; each also opens a connection to the broker,
which queues up to 20 messages if the page does not read.
"""
UNSENT_BYTES_MAX: Final = 1 << 20
"""Answers (pongs) in bytes that a peer may leave unread; our own messages wait long before that."""
_WEBSOCKETS: Final = ("/mqtt", "/recordings")
_DOWNLOADS: Final = "/recordings/"
_TAR: Final = ".tar"
_METHODS: Final = ("GET", "HEAD")
_TWICE: Final = "found a header more than once, expected each once"
_INDEX: Final = ("/", "/index.html")
_LOGIN: Final = "/login"
_OPEN: Final = (_LOGIN, "/login.js", "/style.css", "/favicon.svg")  # served without a token
_REFUSED: Final = {
    HTTPStatus.UNAUTHORIZED: (
        "expected the token that this server printed at its start or that its token file holds"
    ),
    HTTPStatus.TOO_MANY_REQUESTS: (
        f"too many wrong tokens from your address: wait {access.PERIOD_S:.0f} s"
    ),
}
# Whoever connects and stays silent holds one of the few places for no longer.
_SPEAK_S: Final = 5  # limit for a request, and for the TLS handshake
# As little as possible: what waits here is memory that the page, not the board, decides on.
_FRAMES_WAITING_MAX: Final = 4
_CLOSE_S: Final = 0.5
_STOP_S: Final = 0.7


class Bounds:
    """The open connections and pages, and the number turned away."""

    def __init__(self) -> None:
        self._connections = Connections(CONNECTIONS_MAX)
        self._pages: set[ServerConnection] = set()
        self.turned_away = 0

    def admit(self, connection: socket.socket) -> bool:
        if self._connections.admit(connection):
            return True
        self._turn_away(f"{CONNECTIONS_MAX} connections")
        return False

    def admit_page(self, connection: ServerConnection) -> str:
        """Count a connection as a page; return why it is rejected when too many are open,
        else an empty text.
        """
        if len(self._pages) >= PAGES_MAX:
            return self._turn_away(f"{PAGES_MAX} pages")
        self._pages.add(connection)
        return ""

    def _turn_away(self, many: str) -> str:
        self.turned_away += 1
        why = f"{many} are already open, the limit"
        _log.warning("rejected a connection (%d so far): %s", self.turned_away, why)
        return why

    def connection(self) -> type[ServerConnection]:
        """Return the class of connections that are counted,
        and closed if their client reads nothing.
        """
        pages = self._pages

        class Connection(ServerConnection):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                super().connection_made(transport)
                # Not the server's time-out for opening, which would also end a download.
                self._silence = self.loop.call_later(_SPEAK_S, self.transport.abort)

            def has_spoken(self) -> None:
                self._silence.cancel()

            def connection_lost(self, exc: Exception | None) -> None:
                # Also a page that never finished its handshake must give its place back.
                pages.discard(self)
                self._silence.cancel()
                super().connection_lost(exc)

            def data_received(self, data: bytes) -> None:
                super().data_received(data)
                # websockets answers pings by itself and does not wait until its peer reads the
                # answers.
                if self.transport.get_write_buffer_size() > UNSENT_BYTES_MAX:
                    _log.warning("disconnected a page that kept sending messages but read none")
                    self.transport.abort()

        return Connection


def report_device_errors(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Handle a loop's exception: no traceback for what the system refuses,
    such as one more open file.
    """
    if isinstance(error := context.get("exception"), OSError):
        _log.warning(
            "%s: %s",
            context.get("message", "the system refused a connection"),
            error.strerror or error,
        )
    else:
        loop.default_exception_handler(context)


class HasSpoken(Protocol):
    """A connection whose request has come."""

    def has_spoken(self) -> None:
        """Let it be open from now on."""


def _is_download(path: str) -> bool:
    return path.startswith(_DOWNLOADS) and path.endswith(_TAR)


class Pages:
    """The answers to HTTP requests; permitted WebSocket requests pass.

    Without `tokens`, everybody sees the page; pages of the origins `embed_in` may show it in a
    frame.
    """

    def __init__(
        self,
        files: Mapping[str, File],
        allowed_origins: Collection[str],
        bounds: Bounds,
        tokens: Login | None,
        commands: RecordingCommands,
        embed_in: Collection[str] = (),
    ) -> None:
        self._tokens = tokens
        self._commands = commands
        self._files = files
        self._headers = security_headers(self._files, embed_in)
        self._allowed_origins = allowed_origins
        self._bounds = bounds
        self._refused = ""

    async def answer(self, page: ServerConnection, request: Request) -> Response | None:
        """Return the response to a plain or rejected request; None opens the WebSocket.

        A download is answered here, as long as it takes.
        """
        cast(HasSpoken, page).has_spoken()
        response = self._answer(page, request)
        path = request.path.partition("?")[0]
        if response is not None or not _is_download(path):
            return response
        try:
            await self._commands.download(
                page, request, unquote(path[len(_DOWNLOADS) : -len(_TAR)])
            )
        except LookupError:
            return self._text(HTTPStatus.BAD_REQUEST, _TWICE)
        except BusyError as error:
            later = {"Retry-After": str(RETRY_S)}
            return self._text(HTTPStatus.SERVICE_UNAVAILABLE, str(error), later)
        except DeviceError as error:
            return self._text(HTTPStatus.NOT_FOUND, str(error))
        # Never sent: the connection is closed.
        return self._text(HTTPStatus.OK, "")

    def _answer(self, page: ServerConnection, request: Request) -> Response | None:
        # websockets before 17 rejects all other methods by itself.
        method = getattr(request, "method", "GET")
        if method not in _METHODS:
            return self._text(
                HTTPStatus.METHOD_NOT_ALLOWED,
                "expected GET or HEAD",
                {"Allow": ", ".join(_METHODS)},
            )
        try:
            response = self._get(page, request)
        except LookupError:
            response = self._text(HTTPStatus.BAD_REQUEST, _TWICE)
        if response is not None and method == "HEAD":
            response.body = b""
        return response

    def _get(self, page: ServerConnection, request: Request) -> Response | None:
        path = request.path.partition("?")[0]
        if self._tokens is not None:
            response = self._log_in(self._tokens, page, path, request.headers)
            if response is not None:
                return response
        if path in _WEBSOCKETS:
            return self._check(page, request)
        if _is_download(path):
            return self._refuse_strange_host(request.headers.get("Host") or "")
        file = self._files.get(path)
        if file is None:
            return self._text(HTTPStatus.NOT_FOUND, "not found")
        # After an upgrade the tag differs, so no page runs old files against a new daemon.
        if request.headers.get("If-None-Match") == file.etag:
            return self._response(HTTPStatus.NOT_MODIFIED, b"", {"ETag": file.etag})
        return self._response(
            HTTPStatus.OK, file.body, {"ETag": file.etag, "Content-Type": file.content_type}
        )

    def _log_in(
        self, tokens: Login, page: ServerConnection, path: str, headers: Headers
    ) -> Response | None:
        """Return the response to a request without the token or to a login;
        None if the request may proceed.
        """
        offered, kept = (
            access.offered(headers.get("Authorization")),
            tokens.kept(headers.get("Cookie")),
        )
        if path in _OPEN and offered is None:
            return None
        address, before = str((page.remote_address or ("",))[0]), tokens.wrong
        refused = tokens.refusal(offered, kept, address, time.monotonic())
        if tokens.wrong > before:
            _log.warning("rejected a wrong token from %s (%d so far)", address, tokens.wrong)
        # A person gets the page to log in with; a program gets the status.
        if refused is HTTPStatus.UNAUTHORIZED and path in _INDEX and offered is None:
            return self._response(HTTPStatus.SEE_OTHER, b"", {"Location": _LOGIN.removeprefix("/")})
        if refused is not None:
            # RFC 9110, 11.6.1: 401 states how to log in.
            return self._text(refused, _REFUSED[refused], {"WWW-Authenticate": "Bearer"})
        return (
            self._response(HTTPStatus.NO_CONTENT, b"", {"Set-Cookie": tokens.set_cookie()})
            if path == _LOGIN
            else None
        )

    def _refuse_strange_host(self, host: str) -> Response | None:
        """The response to a page that has pointed its own name at our address, and could read what
        it gets; such a page sends no origin.
        """
        why = [
            access.refusal(f"{scheme}://{host}", host, self._allowed_origins)
            for scheme in ("http", "https")
        ]
        return self._text(HTTPStatus.FORBIDDEN, why[0]) if all(why) else None

    def _check(self, page: ServerConnection, request: Request) -> Response | None:
        if request.headers.get("Upgrade", "").lower() != "websocket":
            return self._text(HTTPStatus.UPGRADE_REQUIRED, "expected a WebSocket from the page")
        refused = access.refusal(
            request.headers.get("Origin"), request.headers.get("Host"), self._allowed_origins
        )
        if not refused:
            full = self._bounds.admit_page(page)
            return self._text(HTTPStatus.SERVICE_UNAVAILABLE, full) if full else None
        if (
            refused != self._refused
        ):  # a browser hides the answer from its user, and retries every second
            _log.warning("rejected a WebSocket: %s", escaped(refused))
        # Only once: the page retries every second.
        self._refused = refused
        return self._text(HTTPStatus.FORBIDDEN, refused)

    def _text(
        self, status: HTTPStatus, text: str, headers: Mapping[str, str] | None = None
    ) -> Response:
        typed = {"Content-Type": "text/plain; charset=utf-8", **(headers or {})}
        return self._response(status, f"{text}\n".encode(), typed)

    def _response(self, status: HTTPStatus, body: bytes, headers: dict[str, str]) -> Response:
        bodiless = status in (HTTPStatus.NOT_MODIFIED, HTTPStatus.NO_CONTENT)
        length = {} if bodiless else {"Content-Length": str(len(body))}
        # Without keep-alive: an idle connection would hold one of the few places.
        everything = Headers({**self._headers, **headers, **length, "Connection": "close"})
        return Response(status.value, status.phrase, everything, body)


def _login(token: str | None, port: int, *, secure: bool, framed: bool) -> Login | None:
    # Browsers send a cookie to every port of a host: without the port in its name, two dashboards
    # on one machine would log each other out.
    return Login(token, f"tacshade-{port}", secure=secure, framed=framed) if token else None


async def run(
    broker: Broker,
    host: str,
    port: int,
    allowed_origins: Collection[str],
    listening: Callable[[str, int], None],
    stop: asyncio.Event,
    *,
    tls: ssl.SSLContext | None = None,
    token: str | None = None,
    read_only: bool = False,
    recordings: Path | None = None,
    embed_in: Collection[str] = (),
) -> None:
    """Serve until `stop` is set, then close every connection within a second. Raises DeviceError.

    `listening(host, port)`: called once the port is open; 0 is a free one. `embed_in`: see `Pages`.
    """
    asyncio.get_running_loop().set_exception_handler(report_device_errors)
    bounds = Bounds()
    bridge = Bridge(broker, read_only=read_only)
    commands = RecordingCommands(recordings, broker, Downloads(), read_only=read_only)

    async def serve_page(page: ServerConnection) -> None:
        assert page.request is not None
        about_recordings = page.request.path.startswith("/recordings")
        await (commands.serve(page) if about_recordings else bridge.carry(page))

    try:
        listener = ListeningSocket(host, port, bounds.admit)
        secure, framed = tls is not None, bool(embed_in)
        tokens = _login(token, listener.getsockname()[1], secure=secure, framed=framed)
        files = load(read_only=read_only, recordings=recordings is not None)
        pages = Pages(files, allowed_origins, bounds, tokens, commands, embed_in)
        server = await serve(
            serve_page,
            sock=listener,
            process_request=pages.answer,
            create_connection=bounds.connection(),
            **_protocol(tls),
        )
    except OSError as error:
        why = f"{error.strerror or error}; expected an address and a free port of this machine"
        raise DeviceError(f"cannot listen on port {port} of {host}: {why}") from error
    listening(*server.sockets[0].getsockname()[:2])
    await stop.wait()
    server.close()
    # The server would wait up to 10 s for a connection that never sent anything.
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(server.wait_closed(), _STOP_S)


def _protocol(tls: ssl.SSLContext | None) -> dict[str, Any]:
    """What every connection speaks, and the limits on it."""
    # A port scanner or a browser that gives up is not worth a log entry;
    # each would cause a traceback.
    quiet = logging.getLogger("websockets.server")
    quiet.setLevel(logging.CRITICAL)
    return {
        "ssl": tls,
        # asyncio refuses these two, even as numbers, on a socket without TLS.
        "ssl_handshake_timeout": _SPEAK_S if tls else None,
        "ssl_shutdown_timeout": _CLOSE_S if tls else None,
        # `Bounds.connection` limits how long a connection may stay silent.
        "open_timeout": None,
        "max_queue": _FRAMES_WAITING_MAX,
        "subprotocols": [Subprotocol("mqtt"), Subprotocol("tacshade-recordings")],
        # Compression would cost the board more than it saves:
        # docs/how-to/dashboard.md has the figures.
        "compression": None,
        "max_size": FROM_PAGE_BYTES_MAX,
        "server_header": None,
        "close_timeout": _CLOSE_S,
        "logger": quiet,
    }
