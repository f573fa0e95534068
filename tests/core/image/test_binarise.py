from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.core.image.binarise import ADAPTIVE_FLOOR, Binariser, binarise, halved, odd, padded
from tacshade_edge.types import F64, U8, Binarisation, Disc

THRESHOLD_LSB = 2
"""How far off the uint8 threshold may be; the docstring of `Binariser` says so."""


def exact_threshold(grey: U8, mask: U8, pitch_px: float) -> F64:
    """The adaptive threshold in float64, pixel by pixel: block means, box means of them, linear between."""
    size = tuple(-(-n // 4) * 4 for n in grey.shape)
    inside, masked = np.zeros(size), np.zeros(size)
    inside[: grey.shape[0], : grey.shape[1]] = mask
    masked[: grey.shape[0], : grey.shape[1]] = grey * (mask > 0)

    def blocks(values: F64) -> F64:
        return np.asarray(values.reshape(size[0] // 4, 4, size[1] // 4, 4).mean(axis=(1, 3)), np.float64)

    weight = (blocks(inside) == 1).astype(float)
    white = blocks(masked) * weight
    half = odd(pitch_px) // 2
    local = np.zeros_like(white)
    for i, j in np.ndindex(*white.shape):
        box = slice(max(i - half, 0), i + half + 1), slice(max(j - half, 0), j + half + 1)
        local[i, j] = white[box].sum() / max(weight[box].sum(), 1)
    local = np.maximum(local, ADAPTIVE_FLOOR * white.sum() / max(weight.sum(), 1))

    def along(values: F64, count: int) -> F64:
        at = np.clip((np.arange(count) + 0.5) / 4 - 0.5, 0, len(values) - 1)
        low = np.minimum(at.astype(int), max(len(values) - 2, 0))
        high = np.minimum(low + 1, len(values) - 1)
        part = (at - low)[:, None]
        return np.asarray(values[low] * (1 - part) + values[high] * part)

    exact = along(along(local, size[0]).T, size[1]).T
    return exact[: grey.shape[0], : grey.shape[1]]


@settings(deadline=None)
@given(
    st.integers(1, 45), st.integers(1, 45), st.floats(-10, 50), st.floats(-10, 50), st.floats(1, 40), st.floats(1, 20),
    st.sampled_from(["noise", "checkerboard", "step", "constant", "extremes"]), st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_the_threshold_is_the_exact_one_within_its_bound(
    height: int, width: int, row_c: float, col_c: float, radius: float, pitch: float, kind: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    mask = disc_mask(height, width, Disc(row_c, col_c, radius)).astype(np.uint8)
    rows, cols = np.indices((height, width))
    grey = {
        "noise": rng.integers(0, 256, mask.shape),
        "checkerboard": 255 * ((rows // (1 + seed % 7) + cols // (1 + seed % 7)) % 2),
        "step": np.where(cols > width / 2, 255, 3),
        "constant": np.full(mask.shape, seed % 256),
        "extremes": 255 * rng.integers(0, 2, mask.shape),
    }[kind].astype(np.uint8)
    white = binarise(grey, mask, "adaptive", pitch)
    assert not white[mask == 0].any()
    assert set(np.unique(white)) <= {0, 1}
    if not mask.any():
        return
    above = grey - exact_threshold(grey, mask, pitch)
    sure = (mask > 0) & (np.abs(above) > THRESHOLD_LSB)
    np.testing.assert_array_equal(white[sure] > 0, above[sure] > 0)


def test_a_binariser_forgets_the_image_before() -> None:
    rng = np.random.default_rng(1)
    mask = disc_mask(41, 43, Disc(20, 21, 18)).astype(np.uint8)
    one, other = (rng.integers(0, 256, mask.shape, dtype=np.uint8) for _ in range(2))
    kept = Binariser(mask, "adaptive", 8.0)
    kept(other)
    np.testing.assert_array_equal(kept(one), binarise(one, mask, "adaptive", 8.0))


@given(st.integers(1, 20), st.integers(1, 20), st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_padding_adds_below_and_right_and_halving_rounds_half_up(rows: int, cols: int, by: int, seed: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (rows, cols), dtype=np.uint8)
    whole = padded(image, by, 7)
    assert whole.shape[0] % by == whole.shape[1] % by == 0
    assert max(whole.shape[0] - rows, whole.shape[1] - cols) < by
    np.testing.assert_array_equal(whole[:rows, :cols], image)
    assert (whole[rows:] == 7).all()
    even = padded(image, 2, 0).astype(int)
    exact = (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2] + 2) // 4
    np.testing.assert_array_equal(halved(even.astype(np.uint8)), exact)


def test_an_odd_window_is_the_nearest() -> None:
    assert [odd(v) for v in (-3, 0, 0.4, 1, 1.9, 2.1, 3, 18.9, 37.92)] == [1, 1, 1, 1, 1, 3, 3, 19, 37]


@pytest.mark.parametrize("method", ["adaptive", "global", "otsu"])
def test_markers_are_white_and_the_outside_is_not(method: Binarisation) -> None:
    grey = np.full((60, 60), 20, np.uint8)
    for row in range(5, 60, 10):
        for col in range(5, 60, 10):
            cv2.circle(grey, (col, row), 2, 200, -1)
    mask = disc_mask(60, 60, Disc(30, 30, 25)).astype(np.uint8)
    bright = np.where(mask > 0, grey, 255).astype(np.uint8)
    np.testing.assert_array_equal(binarise(bright, mask, method, 10.0), (grey > 100) * mask)


@pytest.mark.parametrize("method", ["adaptive", "global", "otsu"])
@pytest.mark.parametrize("level", [0, 128, 255])
def test_a_constant_has_one_colour(method: Binarisation, level: int) -> None:
    mask = disc_mask(40, 40, Disc(20, 20, 15)).astype(np.uint8)
    white = binarise(np.full((40, 40), level, np.uint8), mask, method, 8.0)
    assert not white[mask == 0].any()
    assert len(np.unique(white[mask > 0])) == 1
    assert not binarise(np.full((40, 40), level, np.uint8), 0 * mask, method, 8.0).any()


def test_adaptive_survives_light_that_global_does_not() -> None:
    flat = np.full((120, 120), 0.2)
    for row in range(5, 120, 10):
        for col in range(5, 120, 10):
            cv2.circle(flat, (col, row), 3, 1.0, -1)
    lit = (flat * np.linspace(45, 250, 120)[None, :]).astype(np.uint8)
    mask = np.ones((120, 120), np.uint8)
    wrong = {m: np.mean(binarise(lit, mask, m, 10.0) != (flat > 0.5)) for m in ("adaptive", "global")}
    assert wrong["adaptive"] < 0.002
    assert wrong["global"] > 0.015
