"""Every method, its denoising and the white ratio before it on maps that no sensor gives: finite,
within their range, near float64, the same twice; and ten thousand iterations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from support.examples import examples
from support.extremes import BEYOND, EXTREME_MAPS, any_maps, checkerboard, makers, shapes
from support.hybrid_sfs_oracle import hybrid_sfs
from tacshade_edge.sensor.depth import Depth
from tacshade_edge.sensor.depth.hybrid_iteration import EPS, HybridIteration
from tacshade_edge.sensor.depth.hybrid_sfs import hybrid_depth, unit_by_grey
from tacshade_edge.sensor.geometry.disc import Grid, Window, disc_mask
from tacshade_edge.sensor.image import greyscale
from tacshade_edge.sensor.image.greyscale import chambolle, normalise, shape_grey
from tacshade_edge.sensor.image.preprocess import GreyMaps
from tacshade_edge.sensor.image.white import BoxSums, Integrator, binarise
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import F32, F64, U8, Binarisation, Bool, Disc

ALPHA_MM = 3.0
METHODS: dict[str, Callable[[GreyMaps, float], Depth]] = {
    "paper": lambda maps, alpha_mm: hybrid_depth(maps, alpha_mm, HybridIteration(maps.g_d.shape)),
    "without eq. 11": lambda maps, alpha_mm: hybrid_depth(maps, alpha_mm, unit_by_grey),
}
"""From grey maps to depth: with eq. 11 and without."""
WEIGHTS = sorted({p.tv_weight for p in PROFILES.values() if p.tv_weight > 0} | {1e-3, 1.0, 100.0})
LONG_BOUND = 0.02 / 255  # 0.02 grey levels


def maps_of(g_d: F32, g0: F32 | float = 120.0, inside: Bool | bool = True) -> GreyMaps:
    g0 = np.broadcast_to(np.asarray(g0, np.float32), g_d.shape)
    return GreyMaps(g=g0, g0=g0, g_d=g_d, inside=np.broadcast_to(np.asarray(inside), g_d.shape))


def sound_depth(solver: str, maps: GreyMaps, alpha_mm: float) -> Depth:
    before = tuple(m.tobytes() for m in (maps.g, maps.g0, maps.g_d, maps.inside))
    depth = METHODS[solver](maps, alpha_mm)
    assert depth.height_mm.shape == maps.g_d.shape
    assert depth.height_mm.dtype == np.float32
    assert np.isfinite(depth.height_mm).all()
    assert (depth.height_mm >= 0).all()
    assert not depth.height_mm[~maps.inside].any()
    bad = int(np.count_nonzero(~np.isfinite(maps.g_d) | ~np.isfinite(maps.g0)))
    assert bad <= depth.repaired_px <= bad + 2 * maps.g_d.size
    again = METHODS[solver](maps, alpha_mm)
    assert again.height_mm.tobytes() == depth.height_mm.tobytes()
    assert again.repaired_px == depth.repaired_px
    assert tuple(m.tobytes() for m in (maps.g, maps.g0, maps.g_d, maps.inside)) == before
    return depth


@pytest.mark.parametrize("solver", METHODS)
@pytest.mark.parametrize("beyond", BEYOND)
def test_a_value_that_no_grey_has_is_borne_in_both_maps(solver: str, beyond: str) -> None:
    g_d = EXTREME_MAPS["normal noise"](20, 21)
    g_d[3, 4], g_d[5, 6] = BEYOND[beyond], -BEYOND[beyond]
    sound_depth(solver, maps_of(g_d), ALPHA_MM)
    g0 = np.full((20, 21), 120, np.float32)
    g0[3, 4] = BEYOND[beyond]
    sound_depth(solver, maps_of(EXTREME_MAPS["normal noise"](20, 21), g0), ALPHA_MM)


@pytest.mark.slow
@pytest.mark.parametrize("solver", METHODS)
@given(data=st.data(), shape=shapes, alpha_mm=st.floats(0, 1e300))
@examples(300)
def test_any_maps_are_borne(
    solver: str, data: st.DataObject, shape: tuple[int, int], alpha_mm: float
) -> None:
    g_d, g0 = data.draw(any_maps(shape)), data.draw(any_maps(shape))
    inside = data.draw(st.one_of(arrays(bool, shape), st.just(np.ones(shape, bool))))
    depth = sound_depth(solver, maps_of(g_d, g0, inside), alpha_mm)
    assert float(depth.height_mm.max()) <= alpha_mm * (1 + 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["white spike", "noise 0"])
def test_ten_thousand_iterations_of_the_paper_stay_finite(name: str) -> None:
    grey = normalise(EXTREME_MAPS[name](64, 64), np.ones((64, 64), bool)).astype(np.float64)
    tops = []
    for iterations in (25, 10_000):
        z, repaired = hybrid_sfs(grey, iterations)
        assert np.isfinite(z).all()
        assert repaired == 0
        # Where f' is 0, which is nearly everywhere, an iteration adds f / eps,
        # and |f| is at most 1.
        assert z.max() <= 1.01 * iterations / EPS
        tops.append(float(z.max()))
    print(
        f"figure: eq. 11 at 64x64, {name}: greatest |Z| {tops[0]:.1e} after 25 iterations, "
        f"{tops[1]:.1e} after 10,000"
    )


@pytest.mark.parametrize("name", EXTREME_MAPS)
def test_eq_10_in_float32_is_that_of_float64(name: str) -> None:
    g_d, inside = EXTREME_MAPS[name](48, 50), np.ones((48, 50), bool)
    g0 = EXTREME_MAPS["ramp, axis 0"](48, 50) / 2 + 128
    found = shape_grey(g_d, g0, inside)
    assert (found >= 0).all()
    assert (found <= 1).all()

    def plain(values: F64) -> F64:
        span = values.max() - values.min()
        return (values - values.min()) / span if span > 0 else np.zeros_like(values)

    expected = plain(plain(g_d.astype(np.float64)) * g0.astype(np.float64))
    np.testing.assert_allclose(found, expected, atol=5e-7)


def to_unit(levels: F32) -> F32:
    """From -255 to 255 to 0 to 1."""
    return np.clip((levels + 255) / 510, 0, 1).astype(np.float32)


def sound(image: F32, weight: float) -> F32:
    out = chambolle(image, weight)
    assert out.dtype == np.float32
    assert out.shape == image.shape
    slack = 1e-5 * max(float(np.abs(image).max()), 1e-30)
    assert (out >= image.min() - slack).all()
    assert (out <= image.max() + slack).all()
    assert out.mean(dtype=np.float64) == pytest.approx(image.mean(dtype=np.float64), abs=slack)
    assert chambolle(image, weight).tobytes() == out.tobytes()
    return out


@pytest.mark.slow
@given(
    image=arrays(
        np.float32,
        st.tuples(st.integers(1, 24), st.integers(1, 24)),
        elements=st.floats(-1, 2, width=32),
    ),
    weight=st.sampled_from(WEIGHTS),
)
@examples(300)
def test_any_map_is_borne(image: F32, weight: float) -> None:
    """Subnormals too."""
    sound(image, weight)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "weight"), [("noise 0", 0.1), ("step, axis 0", 1.0)])
def test_ten_thousand_iterations_stay_near_those_of_float64(
    name: str, weight: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = to_unit(EXTREME_MAPS[name](64, 64))
    monkeypatch.setattr(greyscale, "ENOUGH", 0.0)
    found = chambolle(image, weight, 10_000)
    from skimage.restoration import (
        denoise_tv_chambolle,
    )  # takes a second, as SciPy's statistics that it imports

    precise = denoise_tv_chambolle(
        image.astype(np.float64), weight=weight, eps=0, max_num_iter=10_000
    )
    off = float(np.abs(found - precise).max())
    print(
        f"figure: TV, weight {weight}, {name}, 10,000 iterations: "
        f"{255 * off:.1e} grey levels from float64"
    )
    assert off < LONG_BOUND


ROWS, COLS = 96, 128
DISC = Disc(47.3, 64.8, 42.0)
# Float32 holds the sums of a window exactly; one product and one quotient round.
BOUND = 255 * 2e-7


def plain_ratio(white: U8, mask: U8, grid: Grid, side_px: int) -> F64:
    """Eq. 1 in float64, by an integral image of its own."""

    def sums(values: U8) -> F64:
        half = side_px // 2
        total = np.pad(values.astype(np.float64), half).cumsum(0).cumsum(1)
        total = np.pad(total, ((1, 0), (1, 0)))
        row = (int(grid.row0) + int(grid.step_px) * np.arange(grid.rows))[:, None]
        col = (int(grid.col0) + int(grid.step_px) * np.arange(grid.cols))[None, :]
        low, high = 0, side_px
        return (
            total[row + high, col + high]
            - total[row + low, col + high]
            - total[row + high, col + low]
            + total[row + low, col + low]
        )

    inside = sums(mask)
    return np.divide(255 * sums(white), inside, out=np.zeros_like(inside), where=inside > 0)


@pytest.mark.slow
@pytest.mark.parametrize("side_px", [1, 17, 255])
@pytest.mark.parametrize("radius_px", [0.5, 3.0, 42.0, 300.0])
def test_every_period_has_its_ratio(side_px: int, radius_px: float) -> None:
    disc = Disc(DISC.row_c, DISC.col_c, radius_px)
    mask = disc_mask(ROWS, COLS, disc).astype(np.uint8)
    window = Window(0, 0, ROWS, COLS)
    grid, integrator = Grid.of_window(window, 3), Integrator(window, side_px // 2 + 1)
    box_sums = BoxSums(integrator, grid, side_px)
    total = box_sums.sums(integrator.integrate(mask))
    for period in range(2, 130):
        white = checkerboard(period)(ROWS, COLS) // 255 * mask
        g = 255 * box_sums.sums(integrator.integrate(white)) / np.maximum(total, np.float32(1))
        np.testing.assert_allclose(g, plain_ratio(white, mask, grid, side_px), atol=BOUND)
        assert (g >= 0).all()
        assert (g <= 255).all()


@pytest.mark.slow
@given(maker=makers(), method=st.sampled_from(get_args(Binarisation)), pitch_px=st.floats(0.3, 300))
@examples(100)
def test_any_image_is_black_and_white_inside_the_disc_and_black_outside(
    maker: object, method: Binarisation, pitch_px: float
) -> None:
    mask = disc_mask(ROWS, COLS, DISC).astype(np.uint8)
    image = np.ascontiguousarray(maker(ROWS, COLS))  # type: ignore[operator]
    white = binarise(image, mask, method, pitch_px).copy()
    assert white.max() <= 1
    assert not white[mask == 0].any()
    outside_changed = np.where(mask > 0, image, 255 - image)
    assert np.array_equal(binarise(outside_changed, mask, method, pitch_px), white)
