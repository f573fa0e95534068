"""Decode an image's bytes once its header states a size that a camera can have: OpenCV's decoders
trust the header, and make 1.8 GB of 875 kB of PNG.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from tacshade_edge.errors import DecodeError
from tacshade_edge.files.file_kinds import kind_of
from tacshade_edge.types import U8

# OpenCV has such a limit too, but reads it from the environment when it is loaded: a program that
# imports the library may have loaded it before, and may itself read larger images. Its error also
# states no size.
PIXELS_MAX: Final = 1 << 24
SIDE_MAX_PX: Final = 8192

# Markers near the end of a complete file; some cameras pad the end.
_ENDS: Final = ((b"\xff\xd8", b"\xff\xd9"), (b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"))
_TAIL_BYTES: Final = 1024
# Formats that may have 16 bits per pixel.
_DEEP: Final = (
    b"\x89PNG",
    b"II*\0",
    b"MM\0*",
    b"P2",
    b"P3",
    b"P5",
    b"P6",
)
# A dark image's hot pixels do not count.
_DIM_GREY, _HOT_PART = 64, 0.001
# Programs that scale values of fewer bits to 16 repeat them in the low bits, or leave those empty.
_LOW_BITS, _GREY_REPEATED = 3, 257

# OpenCV's own lines on stderr would add to our one.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


def decode_image(data: bytes, flags: int) -> U8:
    """Decode a PNG, JPEG, BMP, TIFF, PGM, PPM or WebP.

    `flags`: OpenCV's flags, with ``IMREAD_IGNORE_ORIENTATION``. Returns (uint8 (H, W) grey or (H,
    W, 3) BGR): at most `SIDE_MAX_PX` per side and `PIXELS_MAX` in all. Raises DecodeError (not an
    image, too large, cut short or visibly damaged; damage in the middle can pass).
    """
    for start, end in _ENDS:
        if data.startswith(start) and end not in data[-_TAIL_BYTES:]:
            raise DecodeError(
                f"found an image cut short after {len(data)} bytes, expected a whole image"
            )
    size_px = _size_px(data)
    if size_px is None or 0 in size_px:
        kind = kind_of(data)
        if not kind or kind.endswith("image"):
            kind = f"{len(data)} bytes that are not an image"
        raise DecodeError(f"found {kind}, expected a whole image")
    width, height = size_px
    if max(size_px) > SIDE_MAX_PX or width * height > PIXELS_MAX:
        expected = (
            f"expected at most {SIDE_MAX_PX} px per side and {PIXELS_MAX >> 20} Mi px in total"
        )
        raise DecodeError(f"found {width}x{height} px, {expected}")
    if data.startswith((b"P2", b"P3")):
        # OpenCV reads no number that ends the file.
        data += b"\n"
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        image = None
    # Another size than the header's: the limit was checked for one picture, and another was
    # decoded.
    if image is None or image.shape[:2] != (height, width):
        raise DecodeError(
            f"found {len(data)} bytes that are damaged or not an image, expected a whole image"
        )
    if data.startswith(_DEEP) and np.count_nonzero(image >= _DIM_GREY) <= image.size * _HOT_PART:
        _check_depth(cv2.imdecode(np.frombuffer(data, np.uint8), flags | cv2.IMREAD_ANYDEPTH))
    return np.asarray(image, np.uint8)


def _check_depth(image: NDArray[Any] | None) -> None:
    """Refuse 16-bit pixels that hold values of 9 to 14 bits, of which the upper 8 bits would be
    dark.
    """
    most = (
        0
        if image is None or image.dtype != np.uint16
        else int(np.quantile(image, 1 - _HOT_PART, method="lower"))
    )
    if image is None or not 0 < most < 1 << 14:
        return
    # A dark picture of all 16 bits is no mistake.
    is_scaled = not np.any(image & _LOW_BITS) or not np.any(image % _GREY_REPEATED)
    if most < 1 << 12 or not is_scaled:
        bits = next(bits for bits in (10, 12, 14) if most < 1 << bits)
        raise DecodeError(
            f"found values up to {most} in 16-bit pixels, expected the full 16 bits; "
            f"multiply {bits}-bit values by {1 << 16 - bits}"
        )


_SEVERAL: Final = "found several pages or an animation, expected a file of a single image"


def _size_px(data: bytes) -> tuple[int, int] | None:
    """Width and height from the header, px; None if the format is unknown."""
    read = next((read for start, read in _HEADERS.items() if data.startswith(start)), None)
    try:
        return None if read is None else read(data)
    # Shorter than its header.
    except struct.error:
        return None


# Chunks begin after the signature.
_PNG_FIRST: Final = 8
# Of one pixel. Fewer levels than these hide what a light touch changes.
_BITS_LEAST: Final = 8


def _png(data: bytes) -> tuple[int, int] | None:
    """The size from the first chunk; all must be as long as stated,
    as the decoder trusts that (ISO/IEC 15948, 5.3).
    """
    at, kind = _PNG_FIRST, b""
    while kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", data, at)
        if (kind == b"IHDR") != (at == _PNG_FIRST) or at + 12 + length > len(data):
            return None
        if kind == b"acTL":
            raise DecodeError(_SEVERAL)
        at += 12 + length
    width, height, bits = struct.unpack_from(">2IB", data, 16)
    _check_bits(bits)
    return width, height


def _check_bits(bits: int) -> None:
    if bits < _BITS_LEAST:
        raise DecodeError(
            f"found {bits} bits per pixel, too few grey levels for a skin, expected 8 or 16"
        )


# Markers of JPEG (ISO/IEC 10918-1, table B.1).
_JPEG_MARKERS: Final = 0xFF00
_JPEG_FILL: Final = 0xFFFF
_JPEG_END: Final = 0xFFD9
_JPEG_FRAMES: Final = frozenset(range(0xFFC0, 0xFFD0)) - {0xFFC4, 0xFFC8, 0xFFCC}
"""Frame headers; the three others are tables, and one for extensions."""
_JPEG_WITHOUT_LENGTH: Final = frozenset(range(0xFFD0, 0xFFD9)) | {0xFF01}


def _jpeg(data: bytes) -> tuple[int, int] | None:
    """The size from the first frame header (ISO/IEC 10918-1, B.2.2),
    skipping segments before it by their length.
    """
    at = 2
    while True:
        (marker,) = struct.unpack_from(">H", data, at)
        if marker == _JPEG_FILL:
            at += 1
        elif marker in _JPEG_FRAMES:
            height, width = struct.unpack_from(">2H", data, at + 5)
            return width, height
        elif marker in _JPEG_WITHOUT_LENGTH:
            at += 2
        elif marker > _JPEG_MARKERS and marker != _JPEG_END:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
        else:
            return None


# The header of OS/2 and Windows 2 (BITMAPCOREHEADER), whose sides have 16 bits.
_BMP_OLD_BYTES: Final = 12


def _bmp(data: bytes) -> tuple[int, int]:
    (header_bytes,) = struct.unpack_from("<I", data, 14)
    width, height, _, bits = struct.unpack_from(
        "<4H" if header_bytes == _BMP_OLD_BYTES else "<2i2H", data, 18
    )
    _check_bits(bits)
    # Negative if the rows are stored from top to bottom.
    return abs(width), abs(height)


_PNM_GAP = rb"(?:\s|#[^\n]*\n)+"
_PNM_SIZE = re.compile(rb"P[2356]" + 3 * (_PNM_GAP + rb"(\d{1,9})") + rb"\s")
_PNM_HEADER_BYTES = 1024


def _pnm(data: bytes) -> tuple[int, int] | None:
    found = _PNM_SIZE.match(data[:_PNM_HEADER_BYTES])
    # OpenCV ignores the greatest value and would take 10 bits for nearly black 16.
    if found and int(found[3]) not in (255, 65535):
        raise DecodeError(
            f"found {int(found[3])} as the greatest value of a pixel, expected 255 or 65535"
        )
    return (int(found[1]), int(found[2])) if found else None


_TIFF_KIND, _TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_BITS, _TIFF_ORIENTATION, _TIFF_FORMAT = (
    254,
    256,
    257,
    258,
    274,
    339,
)
_TIFF_TILES = 322, 323
_TIFF_TAGS = (
    _TIFF_KIND,
    _TIFF_WIDTH,
    _TIFF_HEIGHT,
    _TIFF_BITS,
    _TIFF_ORIENTATION,
    _TIFF_FORMAT,
    *_TIFF_TILES,
)
# The last pair: signed, and floating-point values.
_TIFF_SHORT, _TIFF_THUMBNAIL, _TIFF_NOT_WHOLE = 3, 1, (2, 3)
# A value of at most so many bytes stands in the entry itself, a longer one elsewhere.
_TIFF_INLINE_BYTES = 4


def _tiff(data: bytes) -> tuple[int, int] | None:
    """The size from the first directory (TIFF 6.0, section 2)."""
    order = "<" if data.startswith(b"II") else ">"
    found, following = _tiff_directory(data, order, struct.unpack_from(f"{order}I", data, 4)[0])
    if found.get(_TIFF_FORMAT) in _TIFF_NOT_WHOLE:
        raise DecodeError(
            "found a TIFF of floating-point or signed values, "
            "expected whole numbers of 8 or 16 bits"
        )
    # OpenCV would turn it, whatever the flags say, unlike a JPEG.
    if (orientation := found.get(_TIFF_ORIENTATION, 1)) != 1:
        raise DecodeError(f"found a TIFF with orientation {orientation}, expected 1 or none")
    if (
        following
        and not _tiff_directory(data, order, following)[0].get(_TIFF_KIND, 0) & _TIFF_THUMBNAIL
    ):
        raise DecodeError(_SEVERAL)
    _check_bits(found.get(_TIFF_BITS, 1))
    # The decoder allocates a tile whole, even if it is larger than the image.
    if any(found.get(tag, 0) > SIDE_MAX_PX for tag in _TIFF_TILES):
        return None
    return found.get(_TIFF_WIDTH, 0), found.get(_TIFF_HEIGHT, 0)


def _tiff_directory(data: bytes, order: str, at: int) -> tuple[dict[int, int], int]:
    """The first value of each of `_TIFF_TAGS`, the greatest of a repeated one;
    where the next directory is, or 0.
    """
    (entries,) = struct.unpack_from(f"{order}H", data, at)
    found: dict[int, int] = {}
    for entry in range(at + 2, at + 2 + 12 * entries, 12):
        tag, kind, count = struct.unpack_from(f"{order}2HI", data, entry)
        form, size = (f"{order}H", 2) if kind == _TIFF_SHORT else (f"{order}I", 4)
        value_at = (
            entry + 8
            if size * count <= _TIFF_INLINE_BYTES
            else struct.unpack_from(f"{order}I", data, entry + 8)[0]
        )
        if tag in _TIFF_TAGS:
            found[tag] = max(struct.unpack_from(form, data, value_at)[0], found.get(tag, 0))
    return found, struct.unpack_from(f"{order}I", data, at + 2 + 12 * entries)[0]


_WEBP_ANIMATED = 2
# A side has 14 bits; the two others of its word are no part of it.
_WEBP_SIDE = 0x3FFF


def _webp(data: bytes) -> tuple[int, int] | None:
    """The size from the first chunk (RFC 9649, sections 2.5 to 2.7)."""
    kind = data[8:16]
    if kind == b"WEBPVP8X":
        flags, *low = struct.unpack_from("<B3x6B", data, 20)
        if flags & _WEBP_ANIMATED:
            raise DecodeError(_SEVERAL)
        return (low[0] | low[1] << 8 | low[2] << 16) + 1, (low[3] | low[4] << 8 | low[5] << 16) + 1
    if kind == b"WEBPVP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & _WEBP_SIDE) + 1, (bits >> 14 & _WEBP_SIDE) + 1
    if kind == b"WEBPVP8 ":
        width, height = struct.unpack_from("<2H", data, 26)
        return width & _WEBP_SIDE, height & _WEBP_SIDE
    return None


_HEADERS: Final[dict[bytes, Callable[[bytes], tuple[int, int] | None]]] = {
    b"\x89PNG\r\n\x1a\n": _png,
    b"\xff\xd8": _jpeg,
    b"BM": _bmp,
    b"II*\0": _tiff,
    b"MM\0*": _tiff,
    b"RIFF": _webp,
    **{b"P%d" % kind: _pnm for kind in (2, 3, 5, 6)},
}
