"""A page for a browser on this machine: the camera's picture with the circle,
and the figures of the terminal.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, ClassVar, Final

PORT: Final = 8081
"""Port of the page; if it is taken, the page uses a free one."""

_TIMEOUT_S = 5.0
# A site may resolve its own name to this machine (DNS rebinding):
# the browser then sends that name as the host.
_HOSTS = ("127.0.0.1", "localhost")
_HTML = b"""<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>tacshade-edge capture</title>
<style>
body { margin: 1rem; background: #111; color: #eee; font: 1.1rem/1.5 system-ui, sans-serif }
img { width: min(100%, 60rem); display: block; cursor: crosshair }
#text, #place { white-space: pre-wrap; font-variant-numeric: tabular-nums }
</style>
<h1>The camera, now</h1><img id="picture" alt="what the camera sees">
<p id="place">&nbsp;</p><p id="text"></p>
<script>
const element = (name) => document.getElementById(name);
const [picture, text, place] = ["picture", "text", "place"].map(element);
async function look() {
  try {
    text.textContent = await (await fetch("text", {cache: "no-store"})).text();
    const seen = await fetch("picture.jpg", {cache: "no-store"});
    if (seen.ok) {
      URL.revokeObjectURL(picture.src);
      picture.src = URL.createObjectURL(await seen.blob());
      await picture.decode();
    }
  } catch { text.textContent = "capture has ended"; }
  setTimeout(look, 250);
}
picture.addEventListener("mousemove", (event) => {
  // The middle of the first pixel is 0.
  const row = event.offsetY / picture.height * picture.naturalHeight - 0.5;
  const col = event.offsetX / picture.width * picture.naturalWidth - 0.5;
  place.textContent = `row ${row.toFixed(1)} px, column ${col.toFixed(1)} px`;
});
look();
</script></html>
"""


@dataclass(frozen=True, slots=True)
class Shown:
    """The content of the page: a JPEG and a text."""

    picture: bytes = b""
    text: str = "the camera has delivered no picture yet"


class Page:
    """A page served on the loopback interface by separate threads until `close`.

    `shown`: the program replaces it and never changes it.
    """

    def __init__(self) -> None:
        self.shown = Shown()

        class Handler(_Handler):
            page = self

        try:
            # Only this machine: a camera's picture is nobody else's business, and there is no
            # password.
            self._server = ThreadingHTTPServer(("127.0.0.1", PORT), Handler)
        except OSError:
            self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        # A browser that keeps its connection open must not keep the command from ending.
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, name="page", daemon=True).start()

    @property
    def address(self) -> str:
        """URL of the page."""
        return f"http://127.0.0.1:{self._server.server_address[1]}/"

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    page: ClassVar[Page]
    timeout = _TIMEOUT_S

    def do_GET(self) -> None:
        """Answer requests from this machine's pages with the current content."""
        if self.headers.get("Host", "").partition(":")[0].lower() not in _HOSTS:
            self.send_error(403)
            return
        # Read once: the program may replace it while this thread answers.
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
        """Print nothing: the terminal belongs to the dialogue."""
