from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from support.examples import examples
from tacshade_edge.errors import DecodeError
from tacshade_edge.files.image_bytes import PIXELS_MAX, SIDE_MAX_PX, decode_image
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.sensor.image import greyscale
from tacshade_edge.sensor.image.greyscale import chambolle
from tacshade_edge.types import F32, F64, U8, Disc

RNG = np.random.default_rng(11)


def test_grey_of_three_equal_channels_is_that_channel() -> None:
    grey = RNG.integers(0, 256, (16, 256), dtype=np.uint8)
    np.testing.assert_array_equal(greyscale.to_grey(np.dstack([grey] * 3)), grey)
    assert greyscale.to_grey(grey) is grey


def test_tv_does_not_see_the_outside() -> None:
    g = RNG.uniform(0, 255, (30, 30)).astype(np.float32)
    inside = disc_mask(30, 30, Disc(15, 15, 10))
    other = np.where(inside, g, np.float32(255))
    smooth, again = (greyscale.denoise_tv(v, inside, 0.1) for v in (g, other))
    np.testing.assert_array_equal(smooth[inside], again[inside])


@pytest.mark.parametrize("level", [0, 100, 255])
def test_tv_keeps_a_constant_and_leaves_an_empty_disc_alone(level: float) -> None:
    g = np.full((20, 20), level, np.float32)
    np.testing.assert_allclose(greyscale.denoise_tv(g, np.ones(g.shape, bool), 0.1), g, atol=1e-3)
    assert greyscale.denoise_tv(g, np.zeros(g.shape, bool), 0.1) is g
    assert greyscale.denoise_tv(g, np.ones(g.shape, bool), 0) is g


def literal_eq_10(g_d: F32, g0: F32, inside: np.ndarray) -> F64:
    """Eq. 10 and the normalisation after it, cell by cell in float64."""

    def norm(values: dict[tuple[int, int], float]) -> dict[tuple[int, int], float]:
        low, high = min(values.values()), max(values.values())
        return {k: (v - low) / (high - low) if high > low else 0.0 for k, v in values.items()}

    cells = [tuple(c) for c in np.argwhere(inside)]
    g_hn = norm({c: v * float(g0[c]) for c, v in norm({c: float(g_d[c]) for c in cells}).items()})
    result = np.zeros(g_d.shape)
    for cell, value in g_hn.items():
        result[cell] = value
    return result


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_eqs_9_and_10_are_the_literal_ones(sign: float) -> None:
    g, g0 = (RNG.uniform(0, 255, (12, 14)).astype(np.float32) for _ in range(2))
    inside = disc_mask(12, 14, Disc(6, 7, 5))
    g_d = greyscale.grey_difference(g, g0, inside, sign)
    np.testing.assert_allclose(
        g_d[inside], sign * (g[inside].astype(float) - g0[inside]), atol=1e-4
    )
    assert not g_d[~inside].any()
    np.testing.assert_allclose(
        greyscale.shape_grey(g_d, g0, inside), literal_eq_10(g_d, g0, inside), atol=1e-5
    )


@pytest.mark.parametrize("level", [0.0, 7.5, -3.0])
def test_constants_normalise_to_zero(level: float) -> None:
    values, inside = np.full((5, 6), level, np.float32), np.ones((5, 6), bool)
    assert not greyscale.normalise(values, inside).any()
    assert not greyscale.normalise(values, ~inside).any()
    assert not greyscale.shape_grey(values, values, inside).any()


@pytest.mark.parametrize(
    "scale", [1.0, np.finfo(np.float32).tiny]
)  # whose quotients outside are beyond float32
def test_normalise_spans_zero_to_one_over_the_disc_alone(scale: float) -> None:
    values = np.array([[-9, scale, 2 * scale, 3 * scale, 99]], np.float32)
    inside = np.array([[False, True, True, True, False]])
    np.testing.assert_array_equal(greyscale.normalise(values, inside), [[0, 0, 0.5, 1, 0]])


images = arrays(
    np.float32,
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
    elements=st.floats(-0.5, 1.5, width=32, allow_subnormal=False),
)


def noisy_step(rows: int = 120, cols: int = 160) -> F32:
    image = np.full((rows, cols), 0.3, dtype=np.float32)
    image[rows // 4 : rows // 2, cols // 4 :] = 0.8
    noise: F32 = np.random.default_rng(5).normal(0, 0.05, image.shape).astype(np.float32)
    return image + noise


def theirs(image: F32, weight: float, **how: int) -> F32:
    from skimage.restoration import denoise_tv_chambolle  # half a second, in these tests only

    smooth: F32 = denoise_tv_chambolle(image, weight=weight, **how)
    return smooth


@pytest.mark.slow
@pytest.mark.parametrize("iterations", [1, 3, 200])
@pytest.mark.parametrize("weight", [0.05, 0.1])  # the profiles'
def test_it_is_scikit_images_solver(weight: float, iterations: int) -> None:
    image = noisy_step(113, 151)
    before = image.copy()
    ours, precise = (
        chambolle(each, weight, iterations) for each in (image, image.astype(np.float64))
    )
    assert (ours.dtype, precise.dtype) == (np.float32, np.float64)
    assert np.array_equal(ours, theirs(image, weight, max_num_iter=iterations))
    np.testing.assert_allclose(ours, precise, atol=0.05 / 255)
    assert np.array_equal(image, before)


@pytest.mark.slow
@given(image=images, weight=st.sampled_from([0.01, 0.05, 0.1, 1.0]))
@examples(50)
def test_it_is_scikit_images_solver_on_anything(image: F32, weight: float) -> None:
    assert np.array_equal(chambolle(image, weight), theirs(image, weight))


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
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    head = struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")


def changed(form: str, at: int, value: bytes) -> bytes:
    data = bytearray(WHOLE[form])
    data[at : at + len(value)] = value
    return bytes(data)


def tiff(width: int, height: int) -> bytes:
    entries = b"".join(
        struct.pack("<2H2I", tag, 4, 1, value)
        for tag, value in ((256, width), (257, height), (258, 8))
    )
    return b"II*\0" + struct.pack("<IH", 8, 3) + entries + bytes(4)


JPEG_SIZE_AT = WHOLE[".jpg"].index(b"\xff\xc0") + 5


@pytest.mark.parametrize(
    "data",
    [
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
    with pytest.raises(
        DecodeError,
        match=r"found \d+x\d+ px, expected at most 8192 px per side and 16 Mi px in total",
    ):
        decode_image(data, FLAGS)


def test_what_is_none_of_these_forms_is_not_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    tiles = b"II*\0" + struct.pack("<IH", 8, 1) + struct.pack("<2H2I", 322, 4, 1, 2**24)
    wide = encoded(".hdr", PICTURE.astype(np.float32))
    monkeypatch.delattr(cv2, "imdecode")
    long = changed(".png", 33, b"\xff")  # a chunk of 4 GB, which OpenCV would make room for
    for data in (
        b"",
        b"hello",
        b"P7\n",
        b"\xff\xd8\xff\xd9",
        b"GIF89a",
        tiles,
        wide,
        png(0, 5),
        long,
    ):
        with pytest.raises(
            DecodeError, match=rf"found ({len(data)} bytes that are not an image|text that )"
        ):
            decode_image(data, FLAGS)


@pytest.mark.slow
@pytest.mark.parametrize("form", WHOLE)
@given(
    damage=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=4),
    cut=st.floats(0, 1),
)
def test_damage_is_refused_or_passes_and_nothing_else(
    form: str, damage: list[tuple[float, int]], cut: float
) -> None:
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
