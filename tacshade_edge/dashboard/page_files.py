"""The page's files, as the server sends them, and what a browser may do with them."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

# Python's own table of types depends on the machine,
# and browsers do not execute a module of a wrong type.
_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}
# The page learns what it may do from its own text, before any script runs.
_HTML: Final = b'<html lang="en">'
STATIC: Final = Path(__file__).parent / "static"


@dataclass(frozen=True, slots=True)
class File:
    """One file as the server sends it; `etag` changes with the content."""

    body: bytes
    content_type: str
    etag: str


def load(*, read_only: bool = False, recordings: bool = False) -> dict[str, File]:
    """Load every file of the page by its URL path;
    the page is marked if it may send no requests or has recordings.
    """
    paths = [path for path in sorted(STATIC.rglob("*")) if path.suffix in _TYPES]
    found = {
        f"/{path.relative_to(STATIC)}": _file(path.read_bytes(), _TYPES[path.suffix])
        for path in paths
    }
    index = found["/index.html"]
    learns = b" data-read-only" * read_only + b" data-recordings" * recordings
    index = found["/index.html"] = _file(
        index.body.replace(_HTML, _HTML[:-1] + learns + b">", 1), index.content_type
    )
    # /login has no suffix, so that it reads well in the line that the server prints.
    return {"/": index, "/login": found["/login.html"], **found}


def security_headers(files: Mapping[str, File], embed_in: Collection[str] = ()) -> dict[str, str]:
    """Return the headers of every answer: the page may only load its own files and connect
    to its own server.

    Pages of the origins `embed_in` may show it in a frame. The one inline script, the import map,
    is allowed by its hash; ``blob:`` allows the picture and mqtt.js's worker.
    """
    # A browser runs an inline script only if its hash stands in the policy; import maps cannot be
    # files of their own everywhere.
    inline = re.findall(
        rb'<script type="importmap">(.*?)</script>', files["/index.html"].body, re.DOTALL
    )
    hashes = " ".join(
        f"'sha256-{base64.b64encode(hashlib.sha256(text).digest()).decode()}'" for text in inline
    )
    none = "'none'"
    policy = (
        f"default-src 'none'; script-src 'self' {hashes}; style-src 'self'; img-src 'self' blob:; "
        "connect-src 'self'; worker-src blob:; base-uri 'none'; form-action 'none'; "
        f"frame-ancestors {' '.join(sorted(embed_in)) or none}"
    )
    return {
        "Content-Security-Policy": policy,
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        # The browser revalidates every time, mostly with 304:
        # after an upgrade no page mixes old and new files.
        "Cache-Control": "no-cache",
    }


def _file(body: bytes, content_type: str) -> File:
    return File(body, content_type, f'"{hashlib.sha256(body).hexdigest()[:16]}"')
