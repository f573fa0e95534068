"""Image files, whole or refused: OpenCV fills the rest of a torn JPEG with grey and says nothing."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.errors import DecodeError
from tacshade_edge.types import U8

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp"})
# What the last bytes of a whole file hold, after its first bytes; some cameras pad the end.
_ENDS = ((b"\xff\xd8", b"\xff\xd9"), (b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"))
_TAIL_BYTES = 1024


def read_image(path: Path) -> U8:
    """Read one image.

    Returns
    -------
    uint8 (H, W) grey or (H, W, 3) BGR
        As stored: turned by no EXIF mark, an alpha channel left out, 16 bits brought to 8.

    Raises
    ------
    DecodeError
        Not readable, not an image, or cut short.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DecodeError(f"{path}: {error.strerror or error}, expected an image") from error
    except ValueError as error:  # a NUL in the name
        raise DecodeError(f"{str(path)!r}: {error}, expected an image") from error
    for start, end in _ENDS:
        if data.startswith(start) and end not in data[-_TAIL_BYTES:]:
            raise DecodeError(f"{path}: cut short after {len(data)} bytes, expected a whole image")
    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    if image is None:
        raise DecodeError(f"{path}: found {len(data)} bytes that are no image, expected a whole image")
    return np.asarray(image, dtype=np.uint8)
