from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from skimage.restoration import denoise_tv_chambolle
from support.examples import examples

from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.core.image import greyscale
from tacshade_edge.core.image.greyscale import chambolle
from tacshade_edge.types import F32, F64, Disc

RNG = np.random.default_rng(11)


@given(st.integers(0, 2**32 - 1), st.integers(1, 2000))
def test_eq_1_counts_only_the_disc(seed: int, most: int) -> None:
    rng = np.random.default_rng(seed)
    s_t = rng.integers(0, most + 1, (5, 7)).astype(np.float32)
    s_w = np.rint(s_t * rng.random(s_t.shape)).astype(np.float32)
    g = greyscale.white_ratio(s_w, s_t)
    exact = np.where(s_t > 0, 255 * s_w.astype(float) / np.maximum(s_t, 1).astype(float), 0)
    np.testing.assert_allclose(g, exact, rtol=1e-6, atol=1e-6)
    assert (g >= 0).all()
    assert (g <= 255).all()
    np.testing.assert_allclose(greyscale.white_ratio(255 * s_w, s_t, full_scale=1.0), g, rtol=1e-6)


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
    np.testing.assert_allclose(g_d[inside], sign * (g[inside].astype(float) - g0[inside]), atol=1e-4)
    assert not g_d[~inside].any()
    np.testing.assert_allclose(greyscale.shape_grey(g_d, g0, inside), literal_eq_10(g_d, g0, inside), atol=1e-5)


@pytest.mark.parametrize("level", [0.0, 7.5, -3.0])
def test_constants_normalise_to_zero(level: float) -> None:
    values, inside = np.full((5, 6), level, np.float32), np.ones((5, 6), bool)
    assert not greyscale.normalise(values, inside).any()
    assert not greyscale.normalise(values, ~inside).any()
    assert not greyscale.shape_grey(values, values, inside).any()


def test_what_lies_outside_the_disc_is_not_divided() -> None:
    values = np.array([[0.0, np.finfo(np.float32).tiny, 4.0]], np.float32)
    np.testing.assert_array_equal(greyscale.normalise(values, np.array([[True, True, False]])), [[0, 1, 0]])


def test_normalise_spans_zero_to_one_over_the_disc_alone() -> None:
    values = np.array([[-9, 1, 2, 3, 99]], np.float32)
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


@pytest.mark.parametrize("weight", [0.05, 0.1])  # the profiles'
@pytest.mark.parametrize("shape", [(120, 160), (113, 151)])
def test_it_is_scikit_images_solver(shape: tuple[int, int], weight: float) -> None:
    image = noisy_step(*shape)
    ours = chambolle(image, weight)
    assert ours.dtype == np.float32
    assert np.array_equal(ours, denoise_tv_chambolle(image, weight=weight))
    precise = chambolle(image.astype(np.float64), weight)
    assert precise.dtype == np.float64
    assert np.array_equal(precise, denoise_tv_chambolle(image.astype(np.float64), weight=weight))
    np.testing.assert_allclose(ours, precise, atol=0.05 / 255)


@given(image=images, weight=st.sampled_from([0.01, 0.05, 0.1, 1.0]))
@examples(50)
def test_it_is_scikit_images_solver_on_anything(image: F32, weight: float) -> None:
    assert np.array_equal(chambolle(image, weight), denoise_tv_chambolle(image, weight=weight))


def test_noise_goes_and_a_step_stays() -> None:
    image = noisy_step()
    smooth = chambolle(image, 0.1)
    assert smooth[60:, :].std() < 0.3 * image[60:, :].std()
    assert smooth[35:55, 50:150].mean() - smooth[70:, :].mean() > 0.4


@pytest.mark.parametrize("iterations", [1, 3, 200])
def test_it_stops_after_the_iterations_that_it_is_given(iterations: int) -> None:
    image = noisy_step(40, 50)
    ours = chambolle(image, 0.1, iterations)
    assert np.array_equal(ours, denoise_tv_chambolle(image, weight=0.1, max_num_iter=iterations))


def test_the_input_stays_as_it_is() -> None:
    image = noisy_step()
    before = image.copy()
    chambolle(image, 0.1)
    assert np.array_equal(image, before)
