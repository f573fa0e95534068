"""A ``preview`` states when the picture was captured, in a comment that JPEG's decoders skip."""

from __future__ import annotations

import re
from typing import Final

_START: Final = b"\xff\xd8"
_COMMENT: Final = b"\xff\xfe"
# Times of 64 bits have at most 20 digits.
_STAMP: Final = re.compile(rb"\xff\xd8\xff\xfe\0.wall_ns=(\d{1,20})(?!\d)", re.DOTALL)
_LENGTH_BYTES: Final = 2


def stamped(jpeg: bytes, wall_ns: int) -> bytes:
    """Return a JPEG image with its capture time, in ns since the Unix epoch."""
    text = b"wall_ns=%d" % wall_ns
    length = (_LENGTH_BYTES + len(text)).to_bytes(_LENGTH_BYTES, "big")
    return b"".join((_START, _COMMENT, length, text, jpeg[len(_START) :]))


def capture_wall_ns(jpeg: bytes) -> int | None:
    """Return the capture time; None if it has none, as of daemons before this."""
    found = _STAMP.match(jpeg)
    return None if found is None else int(found[1])
