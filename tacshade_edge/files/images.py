"""Reads and writes image files; refuses incomplete ones."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import cv2

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.image_bytes import decode_image
from tacshade_edge.quoting import shown
from tacshade_edge.regular_files import read_regular
from tacshade_edge.types import U8

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp"})
BYTES_MAX = 64 << 20
_PNG_OPTIONS = (cv2.IMWRITE_PNG_COMPRESSION, 3)


def read_image(path: Path) -> U8:
    """Read one image of at most 64 MiB as stored, uint8 (H, W) grey or (H, W, 3) BGR: ignoring EXIF
    orientation, without an alpha channel, 16 bits reduced to 8.

    Raises DecodeError.
    """
    try:
        data = read_regular(path, BYTES_MAX)
    except OSError as error:
        raise DecodeError(f"{shown(path)}: {error.strerror or error}, expected an image") from None
    try:
        # As stored: a turned picture would not fit its calibration.
        return decode_image(data, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except DecodeError as error:
        raise DecodeError(f"{shown(path)}: {error}") from None


def by_number(path: Path) -> tuple[list[tuple[int, str]], str]:
    """The key of a name's place in its folder: numbers in it sort as numbers, ``frame2`` before
    ``frame10``.
    """
    parts = re.split(r"(\d+)", path.name, flags=re.ASCII)
    # Digits are at every second place, so no number meets a text.
    numbers = [(int(part), "") if at % 2 else (0, part) for at, part in enumerate(parts)]
    return numbers, path.name


def is_hidden(path: Path) -> bool:
    """Whether a name is that of a file that a system puts beside a person's, such as the ``._``
    companions of macOS.
    """
    return path.name.startswith(".")


def images_in(given: Iterable[Path]) -> list[Path]:
    """The given images, and for a folder those in it, by name and number, without hidden files.

    Raises ConfigError for a folder without any.
    """
    images: list[Path] = []
    for path in given:
        # A folder may hold anything else beside its images; a file that is named is meant.
        if path.is_dir():
            images_there = (
                each
                for each in path.iterdir()
                if each.suffix.lower() in SUFFIXES and not is_hidden(each) and each.is_file()
            )
            found = sorted(images_there, key=by_number)
            if not found:
                expected = f"expected at least one file of {', '.join(sorted(SUFFIXES))}"
                raise ConfigError(f"{shown(path)}: found no image, {expected}")
            images += found
        else:
            images.append(path)
    return images


def png(image: U8) -> bytes:
    """Encode an image as a PNG file, lossless and fast."""
    return bytes(cv2.imencode(".png", image, _PNG_OPTIONS)[1].tobytes())


def size_text(image: U8) -> str:
    """``640x480``, the width and the height of an image in px."""
    return f"{image.shape[1]}x{image.shape[0]}"


def number_in(name: str, prefix: str) -> int:
    """The number in ``PREFIX_NUMBER.png``; 0 in any other name."""
    # 18 digits fit into 64 bits; without re.ASCII, digits of other scripts would count.
    found = re.fullmatch(rf"{prefix}_(\d{{1,18}})\.png", name, re.ASCII)
    return int(found[1]) if found else 0
