"""What the camera sees, for a browser on this machine: the picture and the same figures as in the terminal."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, ClassVar, Final

PORT: Final = 8081
"""Of the page; a free one where it is taken."""

_TIMEOUT_S = 5.0
# A site may give its own name this machine's address (DNS rebinding): the browser then tells that name as the host.
_HOSTS = ("127.0.0.1", "localhost")
_HTML = b"""<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>tacshade-edge capture</title>
<style>
body { margin: 1rem; background: #111; color: #eee; font: 1.1rem/1.5 system-ui, sans-serif }
img { width: min(100%, 60rem); display: block }
p { white-space: pre-wrap; font-variant-numeric: tabular-nums }
</style>
<h1>The camera, now</h1><img id="picture" alt="what the camera sees"><p id="text"></p>
<script>
const picture = document.getElementById("picture"), text = document.getElementById("text");
let drawn = "";
async function look() {
  try {
    const told = await fetch("text", {cache: "no-store"});
    text.textContent = await told.text();
    const seen = await (await fetch("picture.jpg", {cache: "no-store"})).blob();
    const url = URL.createObjectURL(seen);
    picture.src = url;
    if (drawn) URL.revokeObjectURL(drawn);
    drawn = url;
  } catch { text.textContent = "capture has ended"; }
  setTimeout(look, 250);
}
look();
</script></html>
"""


@dataclass(frozen=True, slots=True)
class Shown:
    """What the page shows: a JPEG, and a text."""

    picture: bytes = b""
    text: str = "the camera has given no picture yet"


class Page:
    """Serves on the loopback interface until it is closed, in threads of its own that read `shown` alone.

    Attributes
    ----------
    shown : Shown
        Replaced by the program, never changed.
    """

    def __init__(self) -> None:
        self.shown = Shown()

        class Handler(_Handler):
            page = self

        try:
            self._server = ThreadingHTTPServer(("127.0.0.1", PORT), Handler)
        except OSError:
            self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, name="page", daemon=True).start()

    @property
    def address(self) -> str:
        """To be opened."""
        return f"http://127.0.0.1:{self._server.server_address[1]}/"

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    page: ClassVar[Page]
    timeout = _TIMEOUT_S

    def do_GET(self) -> None:
        """Answer with what there is now, to pages of this machine."""
        if self.headers.get("Host", "").partition(":")[0].lower() not in _HOSTS:
            self.send_error(403)
            return
        shown = self.page.shown
        content: dict[str, tuple[str, bytes]] = {
            "/": ("text/html; charset=utf-8", _HTML),
            "/text": ("text/plain; charset=utf-8", shown.text.encode()),
            "/picture.jpg": ("image/jpeg", shown.picture),
        }
        kind, body = content.get(self.path, ("text/plain", b""))
        self.send_response(200 if body else 404)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: the terminal is the person's."""
