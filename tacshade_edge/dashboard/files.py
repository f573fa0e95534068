"""The page's files, held in memory: the server serves nothing else."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Final

# Python's own table of types depends on the machine, and browsers do not execute a module of a wrong type.
_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}
_HTML: Final = b'<html lang="en">'


@dataclass(frozen=True, slots=True)
class File:
    """One file as the server sends it; `etag` changes with the content."""

    body: bytes
    content_type: str
    etag: str


def load(*, read_only: bool = False, recordings: bool = False) -> dict[str, File]:
    """Load every file of the page by its URL path; ``/`` is ``/index.html``, ``/login`` is ``/login.html``.

    The page is marked as one that may not send requests, or has a list of recordings.
    """
    found = dict(_walk(resources.files(__package__) / "static", ""))
    index = found["/index.html"]
    learns = b" data-read-only" * read_only + b" data-recordings" * recordings
    index = found["/index.html"] = _file(index.body.replace(_HTML, _HTML[:-1] + learns + b">", 1), index.content_type)
    return {"/": index, "/login": found["/login.html"], **found}


def security_headers(files: Mapping[str, File]) -> dict[str, str]:
    """Return the headers of every answer: the page may only load its own files and connect to its own server.

    The import map cannot be a separate file yet: it is the one inline script, allowed by its hash. ``blob:`` allows
    the camera's picture, and the worker whose timers mqtt.js uses to keep the connection alive in a hidden tab.
    """
    inline = re.findall(rb'<script type="importmap">(.*?)</script>', files["/index.html"].body, re.DOTALL)
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(text).digest()).decode()}'" for text in inline)
    policy = (
        f"default-src 'none'; script-src 'self' {hashes}; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
        "worker-src blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return {
        "Content-Security-Policy": policy,
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        # The browser revalidates every time, mostly with 304: after an upgrade no page mixes old and new files.
        "Cache-Control": "no-cache",
    }


def _walk(folder: Traversable, path: str) -> Iterator[tuple[str, File]]:
    for entry in folder.iterdir():
        name = f"{path}/{entry.name}"
        if entry.is_dir():
            yield from _walk(entry, name)
            continue
        content_type = _TYPES.get(f".{entry.name.rpartition('.')[2]}")
        if content_type is not None:
            yield name, _file(entry.read_bytes(), content_type)


def _file(body: bytes, content_type: str) -> File:
    return File(body, content_type, f'"{hashlib.sha256(body).hexdigest()[:16]}"')
