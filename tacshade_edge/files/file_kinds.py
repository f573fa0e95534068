"""Names what a file is, by its content, to who expected another kind."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Collection
from typing import BinaryIO, Final

from tacshade_edge.quoting import quoted, shown
from tacshade_edge.regular_files import decoded, open_regular

_HEAD_BYTES: Final = 4096
_TAIL_BYTES: Final = 1 << 16
# In a zip file's directory: the length of a name, which begins where this ends.
_ENTRY: Final = re.compile(rb"PK\x01\x02.{24}(..).{16}", re.DOTALL)
_LINE_CHARS: Final = 60
# Where it stands, what stands there, and what the file is.
_MARKS: Final = (
    (0, b"\x89PNG\r\n", "a PNG image"),
    (0, b"\xff\xd8\xff", "a JPEG image"),
    (0, b"II*\0", "a TIFF image"),
    (0, b"MM\0*", "a TIFF image"),
    (8, b"WEBP", "a WebP image"),
    (8, b"AVI ", "a video"),
    (4, b"ftyp", "a video"),
    (0, b"\x1aE\xdf\xa3", "a video"),
    (0, b"\x89MCAP", "an MCAP file"),
    (0, b"%PDF", "a PDF"),
)
# A text may begin with these, too.
_SHORT_MARKS: Final = (
    (b"BM", "a BMP image"),
    (b"P5", "a PGM image"),
    (b"P6", "a PPM image"),
)
_TRUTH: Final = "ground truth"
_ARRAYS: Final = (
    ({"z_mm", "x0_mm", "y0_mm", "step_mm"}, "map of a surface"),
    ({"days", "looks"}, "history of references"),
    ({"height_mm"}, _TRUTH),
    ({"points_mm"}, _TRUTH),
)


def kind_at(path: str | os.PathLike[str]) -> str:
    """What a file is, such as ``a calibration``; an empty text if that is unknown."""
    try:
        with open_regular(path, 1 << 62) as stream:
            return kind_of(stream)
    except OSError:
        return ""


def kind_of(file: BinaryIO | bytes) -> str:
    """What a file's content is, as `kind_at`. Raises OSError."""
    stream = io.BytesIO(file) if isinstance(file, bytes) else file
    head = stream.read(_HEAD_BYTES)
    for at, mark, kind in _MARKS:
        if head[at:].startswith(mark):
            return kind
    if head.startswith(b"PK\3\4"):
        return _zip_kind(stream)
    if (line := _first_line(head)) is not None:
        return f"text that begins with {quoted(line[:_LINE_CHARS])}" if line else ""
    return next((kind for mark, kind in _SHORT_MARKS if head.startswith(mark)), "")


def npz_kind(names: Collection[str], meta: bytes) -> str:
    """What an ``.npz`` file with these arrays and this JSON of ours is, without an article; an
    empty text if that is unknown.
    """
    if "reference_white" in names:
        if b'"belongs_to"' in meta:
            return "stored reference"
        return "calibration" if not meta or b'"pitch_px"' in meta else ""
    if b'"touches"' in meta:
        return "file of objects"
    return next((kind for arrays, kind in _ARRAYS if arrays <= set(names)), "")


def _zip_kind(stream: BinaryIO) -> str:
    # Nothing is unpacked, and of the directory no more is read than its end.
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - _TAIL_BYTES))
    tail = stream.read(_TAIL_BYTES)
    names = [
        tail[found.end() : found.end() + int.from_bytes(found[1], "little")].decode(
            errors="replace"
        )
        for found in _ENTRY.finditer(tail)
    ]
    arrays = {name.removesuffix(".npy") for name in names if name.endswith(".npy")}
    kind = npz_kind(arrays, b"")
    if kind == "calibration":
        return "a calibration or a stored reference"
    if kind:
        return kind if kind == _TRUTH else f"a {kind}"
    # Without names or with one of these, it is damaged, or one of ours that is of no kind.
    if not names or arrays & {"meta", "crc32"}:
        return ""
    if arrays:
        return f"an .npz file of {shown(', '.join(sorted(arrays)), _LINE_CHARS)}"
    return "a backup" if names[:1] == ["settings.yaml"] else "a zip file"


def _first_line(head: bytes) -> str | None:
    """The first line that says something; None if this is no text."""
    if b"\0" in head and head[:2] not in (b"\xff\xfe", b"\xfe\xff"):
        return None
    # What was read may end within a character, or a line.
    whole = head if len(head) < _HEAD_BYTES else head[: head.rfind(b"\n") + 1]
    try:
        lines = decoded(whole).splitlines()
    except UnicodeDecodeError:
        return None
    return next((line.strip() for line in lines if line.strip()), "")
