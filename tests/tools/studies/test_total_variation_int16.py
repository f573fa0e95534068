"""Near float64, in formats whose range is worked out here once more, and faithful to its input's mean."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.examples import examples

from tacshade_edge.core.image import total_variation
from tacshade_edge.core.image.total_variation import chambolle
from tacshade_edge.types import F32, F64
from tools.studies import total_variation_int16
from tools.studies.total_variation_int16 import GREATEST_LENGTHS, GREATEST_LEVELS, chambolle_int16, fraction_bits

FULL_SCALE = 2**15 - 1
LSB_AFTER_30 = 12
WEIGHTS = [1e-4, 0.01, 0.05, 0.1, 0.2, 1.0]

images = arrays(np.float32, st.tuples(st.integers(1, 24), st.integers(1, 24)), elements=st.floats(0, 1, width=32))


def lsb_off(image: F32, weight: float, iterations: int) -> float:
    """From float64 after equally many iterations."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (total_variation, total_variation_int16):
            patch.setattr(module, "ENOUGH", -1.0)
        found = chambolle_int16(image, weight, iterations)
        precise = chambolle(image.astype(np.float64), weight, iterations)
    return float(255 * 2 ** fraction_bits(weight) * np.abs(found - precise).max())


def greatest(of_p: Callable[[F64], F64]) -> float:
    """How great a linear function of p at the middle pixel becomes where no p is longer than 1."""
    side, middle = 7, 3
    coefficients = np.zeros((2, side, side))
    for index in np.ndindex(coefficients.shape):
        p = np.zeros_like(coefficients)
        p[index] = 1
        coefficients[index] = of_p(p)[middle, middle]
    return float(np.hypot(*coefficients).sum())


def divergence(p: F64) -> F64:
    down, right = p
    return np.roll(down, 1, axis=0) - down + np.roll(right, 1, axis=1) - right


def gradient(u: F64) -> tuple[F64, F64]:
    return np.roll(u, -1, axis=0) - u, np.roll(u, -1, axis=1) - u


def directional(p: F64, angle: float) -> F64:
    down, right = gradient(divergence(p))
    return np.cos(angle) * down + np.sin(angle) * right


def test_nothing_can_leave_its_format() -> None:
    """No p becomes longer than W: a p of W less a step, over W and that step's length."""
    norm = max(greatest(lambda p, angle=angle: directional(p, angle)) for angle in np.linspace(0, np.pi, 61))
    reached = {  # levels, W
        "divergence of p / τ": (0, 4 * greatest(divergence)),
        "part of the gradient": (255, greatest(lambda p: gradient(divergence(p))[0])),
        "(p - τ gradient) / τ": (255, greatest(lambda p: 4 * p[0] - gradient(divergence(p))[0])),
        "4 W + norm": (255 * np.sqrt(2), 4 + norm),
    }
    stated = ((0, 13.7), (255, 6.7), (255, 6.7), (361, 13.3))
    for (levels, lengths), (stated_levels, stated_lengths) in zip(reached.values(), stated, strict=True):
        assert stated_levels - 1 < levels <= stated_levels
        assert stated_lengths - 0.1 < lengths <= stated_lengths
        for weight in WEIGHTS:
            assert levels + 255 * weight * lengths < GREATEST_LEVELS + GREATEST_LENGTHS * 255 * weight


@pytest.mark.parametrize("weight", WEIGHTS)
def test_as_many_bits_as_fit(weight: float) -> None:
    most = (GREATEST_LEVELS + GREATEST_LENGTHS * 255 * weight) * 2 ** fraction_bits(weight)
    assert FULL_SCALE / 2 < most <= FULL_SCALE


def test_a_weight_that_leaves_no_bits_is_refused() -> None:
    with pytest.raises(ValueError, match=r"found a weight of 1\.01, expected at most 1"):
        chambolle_int16(np.zeros((4, 4), np.float32), 1.01)


@given(image=images, weight=st.sampled_from(WEIGHTS))
@examples(60)
def test_it_is_near_float64_after_equally_many_iterations(image: F32, weight: float) -> None:
    assert lsb_off(image, weight, 30) <= LSB_AFTER_30


@pytest.mark.parametrize("weight", [0.05, 0.1])
def test_it_stops_about_where_float64_does(weight: float) -> None:
    image = np.random.default_rng(5).normal(0, 0.05, (60, 80)).astype(np.float32)
    image += np.where(np.arange(80) < 30, np.float32(0.3), np.float32(0.7))
    found, precise = chambolle_int16(image, weight), chambolle(image.astype(np.float64), weight)
    assert 255 * np.abs(found - precise).max() < 0.5
    assert 255 * np.abs(found - image).max() > 20


@pytest.mark.parametrize("weight", WEIGHTS)
def test_a_constant_stays_to_the_bit_and_the_mean_of_any_image_stays(weight: float) -> None:
    constant = np.full((9, 11), np.float32(0.1234567))
    assert np.array_equal(chambolle_int16(constant, weight), constant)
    image = np.random.default_rng(3).uniform(0, 1, (61, 64)).astype(np.float32)
    assert chambolle_int16(image, weight).mean(dtype=np.float64) == pytest.approx(
        image.mean(dtype=np.float64), abs=1e-7
    )


@pytest.mark.parametrize("extreme", [1.5, 1e30, np.inf])
def test_beyond_its_range_it_saturates(extreme: float) -> None:
    image = np.random.default_rng(4).choice(np.array([-extreme, 0.25, 1 + extreme], np.float32), (20, 30))
    clipped = np.clip(image, 0, 1)
    change = chambolle_int16(clipped, 0.1) - clipped
    assert np.abs(change).max() > 0.1
    np.testing.assert_allclose(chambolle_int16(image, 0.1), image + change, rtol=1e-6, atol=1e-6)


def test_the_input_stays_as_it_is_and_the_bytes_are_the_same() -> None:
    image = np.random.default_rng(6).uniform(0, 1, (40, 50)).astype(np.float32)
    before = image.copy()
    first, second = (chambolle_int16(image, 0.1).tobytes() for _ in range(2))
    assert first == second
    assert np.array_equal(image, before)
    assert chambolle_int16(image, 0.1, 1).tobytes() == image.tobytes()
