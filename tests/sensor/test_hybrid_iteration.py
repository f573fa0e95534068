"""Eq. 11 in float32 against the published iteration in complex128, and that against ref.
[20], cell by cell.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.calibrated_sensor import HALF, calibrated, pressed, unloaded
from support.examples import examples
from support.extremes import EXTREME_MAPS, any_maps, shapes
from support.hybrid_sfs_oracle import hybrid_sfs, unit_height
from tacshade_edge.lab.simulator.press import PAPER_OBJECTS
from tacshade_edge.sensor.depth.hybrid_iteration import HybridIteration
from tacshade_edge.sensor.depth.hybrid_sfs import finite_shape_grey
from tacshade_edge.sensor.image.greyscale import shape_grey
from tacshade_edge.sensor.image.preprocess import GreyMapper, GreyMaps, Preprocessor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import F32, F64, U8, Bool

BOUND = 0.02 / 3
"""Of a greatest height of 1: 0.02 mm of 3 mm."""
DETERMINED = BOUND / 8
"""If the published result changes by more with the rounding of g_hn,
an image has no result to be compared with.
"""
ROUNDINGS = 8
HALF_UNIT = 2.0**-24
"""Relative; g_hn is known to a half of float32's last digit."""


def unit(iteration: HybridIteration, g_hn: F32, inside: Bool) -> F64:
    found, repaired = iteration(g_hn, inside)
    assert found.dtype == np.float32
    assert np.isfinite(found).all()
    assert 0 <= repaired <= g_hn.size
    z = np.where(inside, found, 0).astype(np.float64)
    return z / z.max() if z.any() else z


def own_change(g_hn: F32, inside: Bool) -> float:
    """The most that the published result changes with the rounding of g_hn."""
    rng, exact = np.random.default_rng(0), unit_height(g_hn.astype(np.float64), inside)
    changes = []
    for _ in range(ROUNDINGS):
        factor = 1 + HALF_UNIT * rng.uniform(-1, 1, g_hn.shape)
        changed = np.maximum(g_hn * factor + 1e-12 * rng.uniform(-1, 1, g_hn.shape), 0)
        changes.append(float(np.abs(unit_height(changed, inside) - exact).max()))
    return max(changes)


def difference(g_hn: F32, inside: Bool) -> float:
    found = unit(HybridIteration(g_hn.shape), g_hn, inside)
    return float(np.abs(found - unit_height(g_hn.astype(np.float64), inside)).max())


def grey_of(image: U8) -> tuple[F32, Bool]:
    preprocessor = Preprocessor(calibrated(HALF, 0), PROFILES["paper"])
    maps = GreyMapper(preprocessor).maps(preprocessor.preprocess(preprocessor.grey(image)))
    return finite_shape_grey(maps)[0], maps.inside


@pytest.mark.slow
@pytest.mark.parametrize("name", PAPER_OBJECTS)
@pytest.mark.parametrize("depth_mm", [0.6, 1.5, 3.0])
def test_a_press_is_that_of_complex128(name: str, depth_mm: float) -> None:
    off = difference(*grey_of(pressed(name, depth_mm).image))
    print(f"figure: eq. 11 in float32, {name} {depth_mm} mm deep: off by {3 * off:.5f} of 3 mm")
    assert off < BOUND


def test_the_untouched_skin_is_that_of_complex128() -> None:
    assert difference(*grey_of(unloaded())) < BOUND


@pytest.mark.slow
@pytest.mark.parametrize("reach", [0.0, 1.0, 4.0])
def test_random_images_are_those_of_complex128(reach: float) -> None:
    from scipy.ndimage import gaussian_filter

    inside = np.ones((40, 51), bool)
    determined = 0
    for seed in range(30):
        g_d = gaussian_filter(np.random.default_rng(seed).standard_normal(inside.shape), reach)
        g_hn = shape_grey(g_d.astype(np.float32), np.full(g_d.shape, 120, np.float32), inside)
        if own_change(g_hn, inside) <= DETERMINED:
            determined += 1
            assert difference(g_hn, inside) < BOUND
    assert determined >= 5


@pytest.mark.slow
@pytest.mark.parametrize("name", EXTREME_MAPS)
def test_an_extreme_is_that_of_complex128_where_that_is_determined(name: str) -> None:
    """Equal rows, columns or diagonals give slopes of exactly 0,
    so the last digit of g_hn decides.
    """
    inside = np.ones((48, 50), bool)
    g0 = EXTREME_MAPS["ramp, axis 1"](48, 50) / 2 + 128
    g_hn = shape_grey(EXTREME_MAPS[name](48, 50), g0.astype(np.float32), inside)
    off, own = difference(g_hn, inside), own_change(g_hn, inside)
    print(f"figure: eq. 11, {name}: off by {3 * off:.4f} of 3 mm, its rounding by {3 * own:.4f}")
    assert off < BOUND or own > DETERMINED


@pytest.mark.slow
@given(data=st.data(), shape=shapes)
@examples(100)
def test_any_map_is_that_of_complex128_where_that_is_determined(
    data: st.DataObject, shape: tuple[int, int]
) -> None:
    inside = np.ones(shape, bool)
    g_d = data.draw(any_maps(shape))
    maps = GreyMaps(g=g_d, g0=np.full(shape, 120, np.float32), g_d=g_d, inside=inside)
    g_hn = finite_shape_grey(maps)[0]
    assert difference(g_hn, inside) < BOUND or own_change(g_hn, inside) > DETERMINED


def test_one_image_leaves_no_trace_in_the_next() -> None:
    rng, inside = np.random.default_rng(1), np.ones((20, 31), bool)
    one, other = rng.random((2, 20, 31), dtype=np.float32)
    iteration = HybridIteration(one.shape)
    alone = iteration(one, inside)[0].copy()
    iteration(other, inside)
    assert iteration(one, inside)[0].tobytes() == alone.tobytes()
    assert not iteration(np.zeros_like(one), inside)[0].any()


def test_the_iteration_is_the_literal_one() -> None:
    """Eq. 11 as ref. [20] codes it, written out element by element
    with Python's complex numbers.
    """
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
    found, _ = hybrid_sfs(image)
    expected = np.abs(np.array(z))
    padded = np.pad(expected, 1, mode="edge")
    median = [[np.median(padded[i : i + 3, j : j + 3]) for j in range(cols)] for i in range(rows)]
    assert np.median(found) / np.median(median) == pytest.approx(1, rel=1e-3)
