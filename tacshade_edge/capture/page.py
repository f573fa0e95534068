"""A page for a browser on this machine: the camera's picture with the circle, and the figures of the terminal.

The person states the visible circle by three clicks on the picture.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Annotated, Any, ClassVar, Final

import msgspec

from tacshade_edge.core.geometry.visible_circle import circle_through
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import Disc

PORT: Final = 8081
"""Port of the page; if it is taken, the page uses a free one."""

_TIMEOUT_S = 5.0
_BODY_MOST = 512
# A site may resolve its own name to this machine (DNS rebinding): the browser then sends that name as the host.
_HOSTS = ("127.0.0.1", "localhost")
_HTML = b"""<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>tacshade-edge capture</title>
<style>
body { margin: 1rem; background: #111; color: #eee; font: 1.1rem/1.5 system-ui, sans-serif }
img { width: min(100%, 60rem); display: block }
#text { white-space: pre-wrap; font-variant-numeric: tabular-nums }
#view { position: relative; width: min(100%, 60rem); cursor: crosshair }
/* What a click begins and ends on stays, while the pictures take turns. */
#view img { width: 100%; pointer-events: none }
#view i { position: absolute; width: 9px; height: 9px; margin: -6px; border: 2px solid #f40; border-radius: 50% }
</style>
<h1>The camera, now</h1><div id="view"><img id="picture" alt="what the camera sees"></div><p id="text"></p>
<p>Is the yellow circle not on the rim of the dome, or is there none? Click three points of the rim, far from each
other. <button id="back">Back to the circle that is found</button></p><p id="answer" role="status"></p>
<script>
const [view, text, back, answer] = ["view", "text", "back", "answer"].map((name) => document.getElementById(name));
let picture = document.getElementById("picture"), points = [];
async function look() {
  try {
    const answer = await fetch("text", {cache: "no-store"});
    text.textContent = await answer.text();
    const seen = await fetch("picture.jpg", {cache: "no-store"});
    if (seen.ok) {
      // Decoded beside the one that is shown, which can be clicked until then.
      const next = picture.cloneNode();
      next.src = URL.createObjectURL(await seen.blob());
      await next.decode();
      picture.replaceWith(next);
      if (picture.src) URL.revokeObjectURL(picture.src);
      picture = next;
    }
  } catch { text.textContent = "capture has ended"; }
  setTimeout(look, 250);
}
async function state(rim) {
  points = [];
  view.querySelectorAll("i").forEach((mark) => mark.remove());
  try {
    const said = await fetch("circle", {method: "POST", body: JSON.stringify({points: rim})});
    answer.textContent = await said.text();
  } catch { answer.textContent = "capture has ended"; }
}
view.addEventListener("click", (event) => {
  if (!picture.naturalWidth) return;
  const seen = view.getBoundingClientRect();
  const x = (event.clientX - seen.left) / seen.width, y = (event.clientY - seen.top) / seen.height;
  const mark = document.createElement("i");
  mark.style.left = `${100 * x}%`;
  mark.style.top = `${100 * y}%`;
  view.append(mark);
  // The middle of the first pixel is 0.
  points.push([y * picture.naturalHeight - 0.5, x * picture.naturalWidth - 0.5]);
  answer.textContent = `${points.length} of 3 points`;
  if (points.length === 3) state(points);
});
back.addEventListener("click", () => state(null));
look();
</script></html>
"""


@dataclass(frozen=True, slots=True)
class Shown:
    """The content of the page: a JPEG, a text, and the picture's rows and columns."""

    picture: bytes = b""
    text: str = "the camera has delivered no picture yet"
    shape: tuple[int, int] = (0, 0)


_Pixel = Annotated[float, msgspec.Meta(ge=-1, le=20000)]
_Point = tuple[_Pixel, _Pixel]


class CircleRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Three points (row, col) in px on the visible circle's rim; null to use the circle found in the picture."""

    points: tuple[_Point, _Point, _Point] | None


@dataclass(frozen=True, slots=True)
class Chosen:
    """The visible circle that the person chose; None to use the circle found in the picture."""

    circle: Disc | None


class Page:
    """A page served on the loopback interface by separate threads until `close`.

    The threads read `shown` and put the person's clicks into `chosen`.

    `shown`: the program replaces it and never changes it. `chosen`: the latest choice until the program takes it.
    """

    def __init__(self) -> None:
        self.shown = Shown()
        self.chosen: deque[Chosen] = deque(maxlen=1)

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
        if not self._is_ours():
            self.send_error(403)
            return
        shown = self.page.shown
        content: dict[str, tuple[str, bytes]] = {
            "/": ("text/html; charset=utf-8", _HTML),
            "/text": ("text/plain; charset=utf-8", shown.text.encode()),
            "/picture.jpg": ("image/jpeg", shown.picture),
        }
        kind, body = content.get(self.path, ("text/plain", b""))
        self._answer(200 if body else 404, kind, body)

    def do_POST(self) -> None:
        """Accept a clicked circle from this page only: another site's page sends its own origin."""
        if not self._is_ours() or self.headers.get("Origin", "").lower() != f"http://{self.headers['Host'].lower()}":
            self.send_error(403)
            return
        if self.path != "/circle":
            self.send_error(404)
            return
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdecimal() and len(length) < 9 and int(length) <= _BODY_MOST):
            self.send_error(413 if length else 411)
            return
        status, said = self._choose(self.rfile.read(int(length)))
        self._answer(status, "text/plain; charset=utf-8", said.encode())

    def _choose(self, body: bytes) -> tuple[int, str]:
        try:
            points = msgspec.json.decode(body, type=CircleRequest).points
            chosen = Chosen(None if points is None else _rounded(circle_through(points, self.page.shown.shape)))
        except msgspec.DecodeError as error:
            return 400, f"circle: {error}"
        except ConfigError as error:
            return 400, str(error)
        self.page.chosen.append(chosen)
        return 200, "using your three points" if chosen.circle else "using the circle found in the picture again"

    def _is_ours(self) -> bool:
        return self.headers.get("Host", "").partition(":")[0].lower() in _HOSTS

    def _answer(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing: the terminal belongs to the dialogue."""


def _rounded(disc: Disc) -> Disc:
    """Round the circle to 0.1 px, as exactly as a click can state it."""
    return Disc(round(disc.row_c, 1), round(disc.col_c, 1), round(disc.radius_px, 1))
