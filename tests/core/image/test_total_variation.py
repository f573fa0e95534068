"""Bit for bit against scikit-image; and that it denoises."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.examples import examples

from tacshade_edge.core.image.total_variation import chambolle
from tacshade_edge.types import F32

images = arrays(
    np.float32,
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
    elements=st.floats(-0.5, 1.5, width=32, allow_subnormal=False),
)


def reference(*image: Any, **options: Any) -> Any:
    from skimage.restoration import denoise_tv_chambolle  # takes a second, as SciPy's statistics that it imports

    return denoise_tv_chambolle(*image, **options)


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
    assert np.array_equal(ours, reference(image, weight=weight))
    precise = chambolle(image.astype(np.float64), weight)
    assert precise.dtype == np.float64
    assert np.array_equal(precise, reference(image.astype(np.float64), weight=weight))
    np.testing.assert_allclose(ours, precise, atol=0.05 / 255)


@given(image=images, weight=st.sampled_from([0.01, 0.05, 0.1, 1.0]))
@examples(50)
def test_it_is_scikit_images_solver_on_anything(image: F32, weight: float) -> None:
    assert np.array_equal(chambolle(image, weight), reference(image, weight=weight))


def test_noise_goes_and_a_step_stays() -> None:
    image = noisy_step()
    smooth = chambolle(image, 0.1)
    assert smooth[60:, :].std() < 0.3 * image[60:, :].std()
    assert smooth[35:55, 50:150].mean() - smooth[70:, :].mean() > 0.4


@pytest.mark.parametrize("iterations", [1, 3, 200])
def test_it_stops_after_the_iterations_that_it_is_given(iterations: int) -> None:
    image = noisy_step(40, 50)
    ours = chambolle(image, 0.1, iterations)
    assert np.array_equal(ours, reference(image, weight=0.1, max_num_iter=iterations))


def test_the_input_stays_as_it_is() -> None:
    image = noisy_step()
    before = image.copy()
    chambolle(image, 0.1)
    assert np.array_equal(image, before)
