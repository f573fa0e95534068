"""Splitting, labelling and describing heights that no solver should give."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.examples import examples
from support.extremes import EXTREME_MAPS

from tacshade_edge.core.contact.objects import BINS, find_objects, two_means_split
from tacshade_edge.core.geometry.disc import Grid, disc_rays
from tacshade_edge.types import F32, Disc, Geometry

finite = st.floats(allow_nan=False, allow_infinity=False, width=32)


def within(values: F32, threshold: float) -> float:
    """Sum of squares within the two clusters of a threshold, in parts of the values' range squared."""
    unit = values.astype(np.longdouble) / (np.longdouble(values.max()) - np.longdouble(values.min()))
    parts = (unit[values <= threshold], unit[values > threshold])
    return sum(float(((part - part.mean()) ** 2).sum()) for part in parts if part.size)


@pytest.mark.slow
@given(values=arrays(np.float32, st.integers(1, 200), elements=finite))
@examples(300)
def test_any_finite_values_are_split_as_well_as_bins_allow(values: F32) -> None:
    threshold = two_means_split(values)
    assert two_means_split(values) == threshold
    if values.min() == values.max():
        assert threshold == float("inf")
        return
    # Neither cluster is empty, though a bin is all that a threshold is known by.
    assert values.min() <= threshold <= values.max()
    ordered = np.unique(values)
    best = min(within(values, float(split)) for split in ordered[:-1])
    assert within(values, threshold) <= best + 2 * values.size / BINS


@pytest.mark.parametrize("values", [(0.0, -1e-45), (1.0, 1.0000001), (-1e-45, 0.0, 1e-45)])
def test_values_with_none_between_are_split(values: tuple[float, ...]) -> None:
    given = np.array(values, np.float32)
    assert 0 < np.count_nonzero(given > two_means_split(given)) < given.size


@pytest.mark.parametrize("name", EXTREME_MAPS)
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_every_extreme_map_is_split(name: str, scale: float) -> None:
    values = (EXTREME_MAPS[name](40, 50) * np.float32(scale)).ravel()
    threshold = two_means_split(values)
    if values.min() == values.max():
        assert threshold == float("inf")
    else:
        assert float(values.min()) <= threshold <= float(values.max())
        assert 0 < np.count_nonzero(values > threshold) < values.size


@pytest.mark.slow
@given(
    height=arrays(np.float32, (20, 22), elements=st.floats(0, 20, width=32)),
    touched=arrays(bool, (20, 22)),
    distance_mm=st.none() | st.floats(0, 1000, exclude_min=True),
    radius_px=st.floats(1, 1000),
)
@examples(150)
def test_any_heights_are_described(
    height: F32, touched: np.ndarray, distance_mm: float | None, radius_px: float
) -> None:
    geometry = Geometry(20.0, distance_mm, 50.0, Disc(9.5, 10.5, radius_px))
    rays = disc_rays(Grid(20, 22, 0.0, 0.0, 1.0), geometry)
    touched = touched & rays.inside
    map_mm = np.where(rays.inside, height, np.float32(np.nan))
    found = find_objects(touched, map_mm, None, rays, geometry)
    if found is None:
        return
    assert not (found.contact & ~touched).any()
    assert np.isfinite(found.cloud.points_mm).all()
    assert len(found.cloud.labels) == found.contact.sum()
    # A cell's area is at most that of the parallelogram of two steps across the whole skin.
    assert 0 <= found.volume_mm3 <= 20 * 40 * 40 * found.contact.sum()
    areas = [touch.area_mm2 for touch in found.described]
    assert areas == sorted(areas, reverse=True)
