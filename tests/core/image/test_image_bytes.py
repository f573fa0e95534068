from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.image.image_bytes import PIXELS_MAX, SIDE_MAX_PX, decode_image
from tacshade_edge.errors import DecodeError
from tacshade_edge.types import U8

FLAGS = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
PICTURE = np.random.default_rng(5).integers(0, 256, (24, 33, 3), dtype=np.uint8)


def encoded(suffix: str, picture: U8 = PICTURE, *options: int) -> bytes:
    return cv2.imencode(suffix, picture, options)[1].tobytes()


WHOLE = {
    **{suffix: encoded(suffix) for suffix in (".png", ".jpg", ".bmp", ".tiff", ".ppm", ".webp")},
    ".pgm": encoded(".pgm", PICTURE[:, :, 0]),
    "ascii.ppm": encoded(".ppm", PICTURE, cv2.IMWRITE_PXM_BINARY, 0),
    "lossy.webp": encoded(".webp", PICTURE, cv2.IMWRITE_WEBP_QUALITY, 80),
    "progressive.jpg": encoded(".jpg", PICTURE, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
}


@pytest.mark.parametrize("form", WHOLE)
def test_every_form_is_decoded(form: str) -> None:
    assert decode_image(WHOLE[form], FLAGS).shape[:2] == PICTURE.shape[:2]


def png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")


def changed(form: str, at: int, value: bytes) -> bytes:
    data = bytearray(WHOLE[form])
    data[at : at + len(value)] = value
    return bytes(data)


def tiff(width: int, height: int) -> bytes:
    entries = b"".join(struct.pack("<2H2I", tag, 4, 1, value) for tag, value in ((256, width), (257, height)))
    return b"II*\0" + struct.pack("<IH", 8, 2) + entries + bytes(4)


JPEG_SIZE_AT = WHOLE[".jpg"].index(b"\xff\xc0") + 5


@pytest.mark.parametrize(
    "data",
    [
        png(30000, 30000),
        png(100_000, 100_000),
        png(SIDE_MAX_PX + 1, 1),
        png(SIDE_MAX_PX, PIXELS_MAX // SIDE_MAX_PX + 1),
        changed(".jpg", JPEG_SIZE_AT, b"\xff\xff\xff\xff"),
        changed(".bmp", 18, struct.pack("<2i", 2**30, -(2**30))),
        tiff(2**31, 2**31),
        b"P5 999999999 999999999 255\n",
        b"RIFF\0\0\0\0WEBPVP8X" + bytes(8) + b"\xff" * 6 + bytes(20),
        b"RIFF\0\0\0\0WEBPVP8L" + bytes(5) + b"\xff" * 4 + bytes(20),
        b"RIFF\0\0\0\0WEBPVP8 " + bytes(10) + b"\xff" * 4 + bytes(20),
    ],
)
def test_a_size_that_no_camera_has_is_refused_before_it_is_decoded(
    data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(cv2, "imdecode")
    with pytest.raises(DecodeError, match=r"found \d+x\d+ px, expected at most 8192 px per side and 16 Mi px in total"):
        decode_image(data, FLAGS)


def test_what_is_none_of_these_forms_is_not_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    tiles = b"II*\0" + struct.pack("<IH", 8, 1) + struct.pack("<2H2I", 322, 4, 1, 2**24)
    wide = encoded(".hdr", PICTURE.astype(np.float32))
    monkeypatch.delattr(cv2, "imdecode")
    long = changed(".png", 33, b"\xff")  # a chunk of 4 GB, which OpenCV would make room for
    for data in (b"", b"hello", b"P7\n", b"\xff\xd8\xff\xd9", b"GIF89a", tiles, wide, png(0, 5), long):
        with pytest.raises(DecodeError, match=rf"found {len(data)} bytes that are not an image"):
            decode_image(data, FLAGS)


@pytest.mark.slow
@pytest.mark.parametrize("form", WHOLE)
@given(damage=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=4), cut=st.floats(0, 1))
def test_damage_is_refused_or_passes_and_nothing_else(form: str, damage: list[tuple[float, int]], cut: float) -> None:
    bad = bytearray(WHOLE[form])
    for place, value in damage:
        bad[int(place**4 * (len(bad) - 1))] = value  # mostly in the header
    if cut < 0.3:
        del bad[int(len(bad) * cut) :]
    try:
        image = decode_image(bytes(bad), FLAGS)
    except DecodeError:
        return
    assert image.size <= 3 * PIXELS_MAX
    assert image.dtype == np.uint8


def test_opencv_says_nothing_beside_our_line(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(DecodeError, match="damaged"):
        decode_image(changed(".bmp", 30, b"\xff"), FLAGS)
    assert capfd.readouterr().err == ""
