"""Maps of floats that no grey image gives: what the solvers and filters must bear. float32, for any size."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from support.extreme_images import EXTREME_IMAGES
from tacshade_edge.types import F32

EXTREME_MAPS: dict[str, Callable[[int, int], F32]] = {
    # g_d as far as it goes: of full range, both signs.
    **{
        name: lambda r, c, image=image: 2 * image(r, c).astype(np.float32) - 255
        for name, image in EXTREME_IMAGES.items()
    },
    "antidiagonal": lambda r, c: np.subtract.outer(np.arange(r), np.arange(c)).astype(np.float32),  # p = -q everywhere
    "normal noise": lambda r, c: np.random.default_rng(4).normal(0, 100, (r, c)).astype(np.float32),
    "subnormal noise": lambda r, c: (np.random.default_rng(5).normal(0, 1e-42, (r, c))).astype(np.float32),
    "smallest step": lambda r, c: np.where(np.arange(c) < c // 2, 0, np.float32(1e-45)) * np.ones((r, 1), np.float32),
    "last digit": lambda r, c: (
        np.where(np.arange(c) < c // 2, 100, np.nextafter(np.float32(100), np.float32(101)))
        * np.ones((r, 1), np.float32)
    ),
}

BEYOND: dict[str, float] = {"nan": np.nan, "inf": np.inf, "-inf": -np.inf, "1e38": 1e38, "-3e38": -3e38, "1000": 1000.0}
"""Values that no grey level has."""

any_floats = st.floats(width=32)
shapes = st.tuples(st.integers(1, 24), st.integers(1, 24))


def any_maps(shape: tuple[int, int]) -> st.SearchStrategy[F32]:
    """Every float32 there is, or only grey levels, or one of the named."""
    named = st.sampled_from(sorted(EXTREME_MAPS)).map(lambda name: EXTREME_MAPS[name](*shape))
    return st.one_of(
        arrays(np.float32, shape, elements=any_floats),
        arrays(np.float32, shape, elements=st.floats(-255, 255, width=32)),
        named,
    )
