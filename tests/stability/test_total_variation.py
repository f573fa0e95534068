"""Total-variation denoising at the extremes: within its input's range, its mean kept, near float64, however long."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.examples import examples
from support.extremes import EXTREME_MAPS

from tacshade_edge.core.image import total_variation
from tacshade_edge.core.image.greyscale import denoise_tv
from tacshade_edge.core.image.total_variation import chambolle
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.types import F32

WEIGHTS = sorted({p.tv_weight for p in PROFILES.values() if p.tv_weight > 0} | {1e-3, 1.0, 100.0})
LONG_BOUND = 0.02 / 255  # 0.02 grey levels


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
@pytest.mark.parametrize("weight", WEIGHTS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 64), (8, 8), (61, 64)])
def test_every_extreme_map_is_borne(weight: float, shape: tuple[int, int]) -> None:
    for image in EXTREME_MAPS.values():
        sound(to_unit(image(*shape)), weight)


@pytest.mark.slow
@pytest.mark.parametrize("weight", [p.tv_weight for p in PROFILES.values() if p.tv_weight > 0])
def test_a_whole_image_is_borne(weight: float) -> None:
    sound(to_unit(EXTREME_MAPS["noise 0"](480, 640)), weight)


@pytest.mark.slow
@given(
    image=arrays(np.float32, st.tuples(st.integers(1, 24), st.integers(1, 24)), elements=st.floats(-1, 2, width=32)),
    weight=st.sampled_from(WEIGHTS),
)
@examples(300)
def test_any_map_is_borne(image: F32, weight: float) -> None:
    """Subnormals too."""
    sound(image, weight)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "weight"),
    [
        *((name, 0.1) for name in ("noise 0", "checkerboard 2 px", "step, axis 0", "white spike", "smallest step")),
        ("step, axis 0", 1.0),
    ],
)
def test_ten_thousand_iterations_stay_near_those_of_float64(
    name: str, weight: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = to_unit(EXTREME_MAPS[name](64, 64))
    monkeypatch.setattr(total_variation, "ENOUGH", 0.0)
    found = chambolle(image, weight, 10_000)
    from skimage.restoration import denoise_tv_chambolle  # takes a second, as SciPy's statistics that it imports

    precise = denoise_tv_chambolle(image.astype(np.float64), weight=weight, eps=0, max_num_iter=10_000)
    off = float(np.abs(found - precise).max())
    print(f"figure: TV, weight {weight}, {name}, 10,000 iterations: {255 * off:.1e} grey levels from float64")
    assert off < LONG_BOUND


@pytest.mark.parametrize("weight", WEIGHTS)
def test_nothing_seen_is_nothing_changed(weight: float) -> None:
    g = EXTREME_MAPS["normal noise"](9, 11)
    assert np.array_equal(denoise_tv(g, np.zeros(g.shape, bool), weight), g)
