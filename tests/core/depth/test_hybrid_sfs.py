from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from tacshade_edge.core.depth import Depth, hybrid_sfs
from tacshade_edge.core.depth.hybrid_sfs import hybrid_sfs as iterate
from tacshade_edge.core.image.preprocess import GreyMaps
from tacshade_edge.studies.tradeoff.grid import scaled_grey
from tacshade_edge.types import F32

ALPHA_MM = 3.0
METHODS: dict[str, Callable[[GreyMaps, float], Depth]] = {"paper": hybrid_sfs.hybrid_depth, "grey": scaled_grey}
"""From grey maps to depth: with eq. 11 and without."""


def bump(rows: int = 40, cols: int = 50, top: float = 80.0) -> F32:
    y, x = np.mgrid[:rows, :cols]
    return (top * np.exp(-((y - rows / 2) ** 2 + (x - cols / 2) ** 2) / 60)).astype(np.float32)


def solve(solver: str, g_d: F32, *, inside: bool = True) -> Depth:
    g0 = np.full(g_d.shape, 120, np.float32)
    maps = GreyMaps(g=g0 + g_d, g0=g0, g_d=g_d, inside=np.full(g_d.shape, inside))
    return METHODS[solver](maps, ALPHA_MM)


@pytest.mark.parametrize("solver", METHODS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_bad_input_is_repaired_and_counted(solver: str, bad: float) -> None:
    good, g_d = bump(), bump()
    g_d[3, 4] = bad
    depth, unharmed = solve(solver, g_d), solve(solver, good)
    assert np.isfinite(depth.height_mm).all()
    assert unharmed.repaired_px == 0
    assert depth.repaired_px == 1
    # One bad cell far from the contact does not take the contact away.
    assert depth.height_mm.max() == pytest.approx(unharmed.height_mm.max(), rel=0.02)


@pytest.mark.parametrize("solver", METHODS)
def test_outside_the_disc_is_zero(solver: str) -> None:
    assert not solve(solver, bump(), inside=False).height_mm.any()
    g_d = bump()
    inside = np.zeros(g_d.shape, bool)
    inside[:, :30] = True
    g0 = np.full(g_d.shape, 120, np.float32)
    maps = GreyMaps(g=g0 + g_d, g0=g0, g_d=np.where(inside, g_d, np.float32(0)), inside=inside)
    height = METHODS[solver](maps, ALPHA_MM).height_mm
    assert not height[~inside].any()
    assert height[inside].any()


@pytest.mark.parametrize("shape", [(40, 50), (41, 51)])
def test_the_published_iteration_returns_its_input_scaled(shape: tuple[int, int]) -> None:
    image = np.asarray(bump(*shape, top=1.0), np.float64)
    z, repaired = iterate(image)
    flat = cv2.medianBlur(image.astype(np.float32), 3)
    assert np.corrcoef(z.ravel(), flat.ravel())[0, 1] >= 0.99
    assert z.max() / image.max() > 1e14  # divided by the machine epsilon
    assert repaired == 0


def test_the_iteration_is_the_literal_one() -> None:
    """Eq. 11 as ref. [20] codes it, written out element by element with Python's complex numbers."""
    image = np.random.default_rng(4).uniform(0.2, 1, (5, 6))
    rows, cols = image.shape
    p_image, q_image = np.zeros((rows, cols)), np.zeros((rows, cols))
    p_image[:, 1:], q_image[1:] = np.diff(image, axis=1), np.diff(image, axis=0)
    p, q = np.fft.fft2(p_image), np.fft.fft2(q_image)
    z = [[0j] * cols for _ in range(rows)]
    for n in range(26):
        new = [[0j] * cols for _ in range(rows)]
        for i in range(rows):
            for j in range(cols):
                norm2 = 1 + complex(p[i][j]) ** 2 + complex(q[i][j]) ** 2
                r = 1 / norm2**0.5
                f = image[i, j] - (r if r.real >= 0 else 0)
                slope = (complex(p[i][j]) + complex(q[i][j])) / norm2**1.5 + 2.2e-16
                new[i][j] = f if n == 0 else z[i][j] - f / slope
        z = new
        p = [[z[i][j] - z[i][j - 1] if j else 0j for j in range(cols)] for i in range(rows)]
        q = [[z[i][j] - z[i - 1][j] if i else 0j for j in range(cols)] for i in range(rows)]
    found, _ = iterate(image)
    expected = np.abs(np.array(z))
    padded = np.pad(expected, 1, mode="edge")
    median = [[np.median(padded[i : i + 3, j : j + 3]) for j in range(cols)] for i in range(rows)]
    assert np.median(found) / np.median(median) == pytest.approx(1, rel=1e-3)


def test_alpha_is_the_height_of_the_highest() -> None:
    assert solve("paper", bump()).height_mm.max() == pytest.approx(3.0, rel=1e-6)
