from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tacshade_edge.core.clusters import BINS, describe_objects, label_objects, object_cloud, two_means_split


def squares(values: np.ndarray, threshold: float) -> float:
    """Sum of squares within the two clusters of a threshold."""
    parts = (values[values <= threshold], values[values > threshold])
    return sum(float(((p - p.mean()) ** 2).sum()) for p in parts if p.size)


@given(st.lists(st.integers(-1000, 1000), min_size=2, max_size=60).filter(lambda v: len(set(v)) > 1))
@example([0, 1, 2])
@example([0, 99, 99, 99, 101, 101, 101, 200])
@example([0, 0, 0, 1])
def test_the_split_is_the_best_of_all_splits_up_to_a_bin(numbers: list[int]) -> None:
    values = np.array(numbers, np.float32)
    threshold = two_means_split(values)
    assert values.min() <= threshold < values.max()
    exact = np.unique(values).astype(float)
    best = min(squares(values.astype(float), t) for t in exact[:-1])
    bin_width = (exact[-1] - exact[0]) / BINS
    # Each value stands in the middle of its bin, at most half a width off, when the splits are compared.
    allowed = math.sqrt(best) + math.sqrt(len(values)) * bin_width
    assert math.sqrt(squares(values.astype(float), threshold)) <= allowed + 1e-6


def test_the_boundary_of_two_far_clusters_lies_in_the_middle() -> None:
    assert two_means_split(np.array([0, 0, 0, 10, 10], np.float32)) == pytest.approx(5, abs=10 / BINS)


@pytest.mark.parametrize("values", [[], [3.0], [3.0] * 50, [0.0] * 5])
def test_what_does_not_differ_has_no_upper_cluster(values: list[float]) -> None:
    assert two_means_split(np.array(values, np.float32)) == math.inf


def test_neighbouring_floats_still_split() -> None:
    low = np.float32(1)
    high = np.nextafter(low, np.float32(2))
    split = two_means_split(np.array([low, low, high], np.float32))
    assert low <= split < high


CONTACT = np.array(
    [
        [1, 1, 0, 0, 0, 0, 0, 0],
        [1, 0, 0, 0, 0, 1, 1, 1],
        [0, 0, 0, 0, 0, 1, 1, 1],
        [0, 0, 0, 1, 0, 1, 1, 1],
        [0, 0, 0, 0, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0, 0, 0],
        [1, 0, 0, 0, 0, 0, 0, 0],
    ],
    bool,
)


def test_objects_are_numbered_by_area_and_small_ones_vanish() -> None:
    labels = label_objects(CONTACT, np.full(CONTACT.shape, 0.25, np.float32))
    assert set(labels[1:4, 5:].ravel()) == {1}  # 2.25 mm²
    assert {int(labels[0, 0]), int(labels[0, 1]), int(labels[1, 0])} == {2}  # 0.75 mm²
    assert {int(labels[5, 1]), int(labels[6, 0])} == {3}  # 0.5 mm², corner to corner
    assert labels[3, 3] == 0  # 0.25 mm²
    assert labels.max() == 3
    np.testing.assert_array_equal(labels > 0, CONTACT & (np.arange(56).reshape(7, 8) != 27))


def test_area_counts_not_cells() -> None:
    area = np.full(CONTACT.shape, 0.25, np.float32)
    area[3, 3] = 9.0
    assert label_objects(CONTACT, area)[3, 3] == 1


def test_cells_without_an_area_count_nothing() -> None:
    area = np.full(CONTACT.shape, np.nan, np.float32)
    assert label_objects(CONTACT, area).max() == 0
    assert label_objects(np.zeros((3, 3), bool), np.ones((3, 3), np.float32)).max() == 0


def test_descriptions_and_cloud_tell_the_same() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(*CONTACT.shape, 3)).astype(np.float32)
    height = rng.uniform(0, 3, CONTACT.shape).astype(np.float32)
    area = rng.uniform(0.3, 1, CONTACT.shape).astype(np.float32)
    labels = label_objects(CONTACT, area)
    objects = describe_objects(labels, points, height, area)
    cloud = object_cloud(labels, points)
    assert [o.label for o in objects] == list(range(1, labels.max() + 1))
    assert [o.area_mm2 for o in objects] == sorted((o.area_mm2 for o in objects), reverse=True)
    assert (np.diff(cloud.labels.astype(int)) >= 0).all()
    assert len(cloud.points_mm) == len(cloud.labels) == np.count_nonzero(labels)
    for o in objects:
        mine = cloud.points_mm[cloud.labels == o.label].astype(float)
        np.testing.assert_allclose(o.centroid_mm, mine.mean(axis=0), atol=1e-6)
        np.testing.assert_allclose(o.extent_mm, np.ptp(mine, axis=0), atol=1e-6)
        assert o.depth_max_mm == height[labels == o.label].max()
        assert o.area_mm2 == pytest.approx(area[labels == o.label].sum(), rel=1e-5)


def test_no_object_no_cloud() -> None:
    labels = np.zeros((4, 5), np.int32)
    flat = np.zeros((4, 5), np.float32)
    assert describe_objects(labels, np.zeros((4, 5, 3), np.float32), flat, flat) == ()
    cloud = object_cloud(labels, np.zeros((4, 5, 3), np.float32))
    assert cloud.points_mm.shape == (0, 3)
    assert (cloud.points_mm.dtype, cloud.labels.dtype) == (np.float32, np.uint16)
