"""Images and maps at the extremes of what they may be."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tacshade_edge.types import F32, U8

Maker = Callable[[int, int], U8]


def constant(level: int) -> Maker:
    return lambda rows, cols: np.full((rows, cols), level, np.uint8)


def checkerboard(period_px: int, low: int = 0, high: int = 255) -> Maker:
    """Squares of half a period's side; of an odd period one side a pixel longer than the other."""

    def make(rows: int, cols: int) -> U8:
        row, col = (np.arange(n) % period_px < (period_px + 1) // 2 for n in (rows, cols))
        return np.where(row[:, None] ^ col[None, :], np.uint8(high), np.uint8(low))

    return make


def stripes(period_px: int, axis: int) -> Maker:
    def make(rows: int, cols: int) -> U8:
        at = np.indices((rows, cols), sparse=True)[axis]
        return np.broadcast_to(
            np.where(at % period_px < (period_px + 1) // 2, np.uint8(255), np.uint8(0)),
            (rows, cols),
        )

    return make


def spike(high: int, ground: int, side_px: int = 1) -> Maker:
    def make(rows: int, cols: int) -> U8:
        image = np.full((rows, cols), ground, np.uint8)
        image[rows // 2 : rows // 2 + side_px, cols // 2 : cols // 2 + side_px] = high
        return image

    return make


def step(low: int, high: int, axis: int, at: float = 0.5) -> Maker:
    def make(rows: int, cols: int) -> U8:
        index = np.indices((rows, cols), sparse=True)[axis]
        return np.broadcast_to(
            np.where(index < at * (rows, cols)[axis], np.uint8(low), np.uint8(high)), (rows, cols)
        )

    return make


def noise(seed: int) -> Maker:
    """Every value as likely."""
    return lambda rows, cols: np.random.default_rng(seed).integers(0, 256, (rows, cols), np.uint8)


def salt(seed: int, part: float, ground: int) -> Maker:
    def make(rows: int, cols: int) -> U8:
        rng = np.random.default_rng(seed)
        hit = rng.random((rows, cols)) < part
        return np.where(
            hit, rng.integers(0, 2, (rows, cols), np.uint8) * np.uint8(255), np.uint8(ground)
        )

    return make


def ramp(axis: int) -> Maker:
    def make(rows: int, cols: int) -> U8:
        n = (rows, cols)[axis]
        line = np.rint(np.linspace(0, 255, n)).astype(np.uint8)
        return np.broadcast_to(line[:, None] if axis == 0 else line[None, :], (rows, cols))

    return make


EXTREME_IMAGES: dict[str, Maker] = {
    **{f"constant {level}": constant(level) for level in (0, 1, 12, 127, 128, 254, 255)},
    **{
        f"checkerboard {period} px": checkerboard(period)
        for period in (2, 3, 4, 5, 7, 8, 11, 16, 23, 32, 64, 128)
    },
    **{
        f"faint checkerboard {period} px": checkerboard(period, 120, 136)
        for period in (2, 3, 8, 17, 32)
    },
    **{
        f"stripes {period} px, axis {axis}": stripes(period, axis)
        for period in (2, 5, 8, 16)
        for axis in (0, 1)
    },
    "white spike": spike(255, 0),
    "black spike": spike(0, 255),
    "spot": spike(255, 90, 9),
    **{f"step, axis {axis}": step(0, 255, axis) for axis in (0, 1)},
    **{f"small step, axis {axis}": step(100, 130, axis, 0.3) for axis in (0, 1)},
    **{f"noise {seed}": noise(seed) for seed in range(3)},
    "salt and pepper": salt(1, 0.05, 120),
    "snow": salt(2, 0.5, 0),
    **{f"ramp, axis {axis}": ramp(axis) for axis in (0, 1)},
}


@st.composite
def makers(draw: st.DrawFn) -> Maker:
    """Any of these with any parameters, or noise drawn pixel by pixel from few levels."""
    level, period, axis = st.integers(0, 255), st.integers(2, 200), st.integers(0, 1)
    return draw(
        st.one_of(
            st.builds(constant, level),
            st.builds(checkerboard, period, level, level),
            st.builds(stripes, period, axis),
            st.builds(spike, level, level, st.integers(1, 30)),
            st.builds(step, level, level, axis, st.floats(0, 1)),
            st.builds(noise, st.integers(0, 2**32 - 1)),
            st.builds(salt, st.integers(0, 2**32 - 1), st.floats(0, 1), level),
            st.builds(ramp, axis),
        )
    )


EXTREME_MAPS: dict[str, Callable[[int, int], F32]] = {
    # g_d as far as it goes: of full range, both signs.
    **{
        name: lambda r, c, image=image: 2 * image(r, c).astype(np.float32) - 255
        for name, image in EXTREME_IMAGES.items()
    },
    "antidiagonal": lambda r, c: np.subtract.outer(np.arange(r), np.arange(c)).astype(
        np.float32
    ),  # p = -q everywhere
    "normal noise": lambda r, c: np.random.default_rng(4).normal(0, 100, (r, c)).astype(np.float32),
    "subnormal noise": lambda r, c: (np.random.default_rng(5).normal(0, 1e-42, (r, c))).astype(
        np.float32
    ),
    "smallest step": lambda r, c: (
        np.where(np.arange(c) < c // 2, 0, np.float32(1e-45)) * np.ones((r, 1), np.float32)
    ),
    "last digit": lambda r, c: (
        np.where(np.arange(c) < c // 2, 100, np.nextafter(np.float32(100), np.float32(101)))
        * np.ones((r, 1), np.float32)
    ),
}

BEYOND: dict[str, float] = {
    "nan": np.nan,
    "inf": np.inf,
    "-inf": -np.inf,
    "1e38": 1e38,
    "-3e38": -3e38,
    "1000": 1000.0,
}
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
