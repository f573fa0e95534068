"""Where the paper's method breaks, and why: the claims of numerics.md,
each by its own plain code and a figure.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import median_filter

from support.calibrated_sensor import HALF, calibrated, pressed, unloaded
from support.hybrid_sfs_oracle import hybrid_sfs
from tacshade_edge.sensor.depth.hybrid_iteration import EPS, ITERATIONS, HybridIteration
from tacshade_edge.sensor.depth.hybrid_sfs import hybrid_depth
from tacshade_edge.sensor.image.greyscale import shape_grey
from tacshade_edge.sensor.image.preprocess import GreyMapper, GreyMaps, Preprocessor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import F64, Bool

pytestmark = pytest.mark.slow
CELLS = 64


@cache
def maps(touched: bool = True) -> GreyMaps:
    image = pressed("ball", 3.0).image if touched else unloaded()
    preprocessor = Preprocessor(calibrated(HALF, 0), PROFILES["paper"])
    return GreyMapper(preprocessor).maps(preprocessor.preprocess(preprocessor.grey(image)))


@cache
def press() -> tuple[F64, Bool]:
    """g_hn of a ball 3 mm deep on the simulated sensor, and the disc."""
    seen = maps()
    return shape_grey(seen.g_d, seen.g0, seen.inside).astype(np.float64), seen.inside


@cache
def after(iterations: int) -> F64:
    return hybrid_sfs(press()[0], iterations)[0]


def backward(z: npt.NDArray[np.inexact], axis: int) -> npt.NDArray[np.inexact]:
    return np.diff(z, axis=axis, prepend=np.take(z, [0], axis=axis))


def spike(cells: int) -> F64:
    image = np.zeros((cells, cells))
    image[cells // 2, cells // 2] = 1
    return image


def step() -> F64:
    return np.where(np.arange(CELLS) < CELLS // 2, 0.0, 1.0) * np.ones((CELLS, 1))


FLATS = {
    "spike": spike(CELLS),
    "step": step(),
    "antidiagonal ramp": 0.5 + np.subtract.outer(np.arange(CELLS), np.arange(CELLS)) / (2 * CELLS),
}


@pytest.mark.parametrize("name", FLATS)
def test_the_derivative_of_eq_12_is_zero_nearly_everywhere(name: str) -> None:
    """F' = (p + q) / (1 + p² + q²)^1.5 of the light from the camera:
    0 on flats, and wherever p = -q.
    """
    image = FLATS[name]
    part = float(np.mean(backward(image, 1) + backward(image, 0) == 0))
    print(f"figure: f' of eq. 12 is exactly 0 in {100 * part:.0f} % of a {name}")
    assert part > 0.95


def test_the_published_iteration_ends_as_a_scaled_copy_of_the_grey_image() -> None:
    grey, inside = press()
    smooth = median_filter(grey, size=3, mode="nearest")[inside]
    like = {n: float(np.corrcoef(after(n)[inside], smooth)[0, 1]) for n in (0, 1, 2, 5, 25, 100)}
    for n, r in like.items():
        print(
            f"figure: eq. 11, a press, {n} iterations: r = {r:.3f} with g_hn, |Z| up to "
            f"{after(n)[inside].max():.1e}"
        )
    assert like[25] > 0.99
    assert like[100] > like[25]
    assert max(abs(like[n]) for n in (1, 2, 5)) < 0.5  # before that, it is not even that
    # It does not converge: each iteration adds g / eps.
    assert after(100)[inside].max() > 3 * after(25)[inside].max()
    per_grey = float(np.polyfit(smooth, after(25)[inside], 1)[0]) * EPS
    print(f"figure: eq. 11, a press, 25 iterations: |Z| is {per_grey:.1f} g / eps")
    assert 15 < per_grey <= ITERATIONS


def test_without_a_gate_noise_becomes_a_full_height_object() -> None:
    """Eq. 10's normalisation stretches whatever there is to 0 to 1."""
    seen = maps(touched=False)
    height = hybrid_depth(seen, 3.0, HybridIteration(seen.inside.shape)).height_mm
    change, true_change = (float(np.abs(m.g_d[m.inside]).max()) for m in (seen, maps()))
    print(
        f"figure: no contact, g_d within {change:.1f} levels (a press: {true_change:.0f}): "
        f"{height.max():.1f} mm of 3"
    )
    assert change < 0.25 * true_change
    assert height.max() == pytest.approx(3.0)


def test_the_grey_of_the_untouched_skin_is_not_the_shading_of_a_flat() -> None:
    """Eq. 12 wants g_hn to be R, which is 1 where the surface is flat and untouched;
    g_hn is low there.
    """
    grey, inside = press()
    untouched = float(np.median(grey[inside]))
    print(
        f"figure: g_hn of the skin beside a press: {untouched:.2f}; the reflectance of a flat is 1"
    )
    assert untouched < 0.7
