from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tacshade_edge.sensor.contact.objects import (
    BINS,
    LABELS_MAX,
    MIN_OBJECT_MM2,
    TWIST_CELLS,
    Objects,
    cells_by_label,
    find_objects,
    label_objects,
    normals,
    rigid_motion,
    spreads,
    two_means_split,
)
from tacshade_edge.sensor.contact.parting import part_objects
from tacshade_edge.sensor.geometry.disc import DiscRays, Grid, disc_rays, skin_points
from tacshade_edge.types import F32, Bool, Disc, Geometry, ObjectCloud, TouchedObject


def points(n: int, seed: int = 0) -> np.ndarray:
    """(3, N): scattered over some mm of a plane that leans."""
    x, y = np.random.default_rng(seed).uniform(-4, 4, (2, n)) + np.array([[3.0], [-2.0]])
    return np.stack((x, y, 18 - 0.2 * x + 0.1 * y)).astype(np.float32)


def moved(now: np.ndarray, shear: np.ndarray) -> tuple[tuple[float, float], float | None, float]:
    """Of one object."""
    (mean,), (spread,) = spreads(np.concatenate((now, shear)).astype(np.float64), [now.shape[1]])
    return (mean[3], mean[4]), *rigid_motion(spread, now.shape[1])


@given(
    x_mm=st.floats(-5, 5),
    y_mm=st.floats(-5, 5),
    twist_deg=st.floats(-60, 60),
    count=st.integers(TWIST_CELLS, 400),
)
def test_a_rigid_motion_is_found_as_it_is(
    x_mm: float, y_mm: float, twist_deg: float, count: int
) -> None:
    now = points(count)
    a = math.radians(twist_deg)
    middle = now[:2].astype(np.float64).mean(axis=1, keepdims=True)
    back = np.array(((math.cos(a), math.sin(a)), (-math.sin(a), math.cos(a))))
    before = back @ (now[:2] - middle) + middle - np.array([[x_mm], [y_mm]])
    shear_mm, found_deg, strain_mm = moved(now, (now[:2] - before).astype(np.float32))
    assert shear_mm == pytest.approx((x_mm, y_mm), abs=1e-4)
    assert found_deg == pytest.approx(twist_deg, abs=0.01)
    assert strain_mm < 1e-3
    assert moved(now[:, : TWIST_CELLS - 1], np.zeros((2, TWIST_CELLS - 1), np.float32))[1] is None


def test_the_normal_of_each_object_points_away_from_the_camera() -> None:
    first, second = points(40, 1), points(7, 2)[[1, 0, 2]]
    now = np.concatenate((first, second, points(1, 3)), axis=1)
    found = np.array(normals(spreads(now.astype(np.float64), [40, 47, 48])[1]))
    expected = np.array(((0.2, -0.1, 1), (-0.1, 0.2, 1))) / math.sqrt(1.05)
    np.testing.assert_allclose(found[:2], expected, atol=1e-4)
    assert np.linalg.norm(found[2]) == pytest.approx(1.0)
    assert found[2, 2] >= 0


@given(
    st.lists(st.integers(1, 60), min_size=1, max_size=4),
    st.floats(-50, 50),
    st.integers(0, 2**32 - 1),
)
def test_the_spreads_of_objects_far_from_the_axis_are_those_of_values_less_their_mean(
    counts: list[int], away_mm: float, seed: int
) -> None:
    values = away_mm + np.random.default_rng(seed).uniform(-0.1, 0.1, (5, sum(counts)))
    ends = np.cumsum(counts)
    means, found = spreads(values, ends.tolist())
    for mean, spread, part in zip(means, found, np.split(values, ends[:-1], axis=1), strict=True):
        less = part - part.mean(axis=1, keepdims=True)
        np.testing.assert_allclose(mean, part.mean(axis=1), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(spread, less @ less.T, atol=1e-12 * part.shape[1])


def squares(values: np.ndarray, threshold: float) -> float:
    """Sum of squares within the two clusters of a threshold."""
    parts = (values[values <= threshold], values[values > threshold])
    return sum(float(((p - p.mean()) ** 2).sum()) for p in parts if p.size)


@given(
    st.lists(st.integers(-1000, 1000), min_size=2, max_size=60).filter(lambda v: len(set(v)) > 1)
)
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
    # Each value stands in the middle of its bin, at most half a width off,
    # when the splits are compared.
    allowed = math.sqrt(best) + math.sqrt(len(values)) * bin_width
    assert math.sqrt(squares(values.astype(float), threshold)) <= allowed + 1e-6


@pytest.mark.parametrize("values", [[], [3.0], [3.0] * 50, [0.0] * 5])
def test_what_does_not_differ_has_no_upper_cluster(values: list[float]) -> None:
    assert two_means_split(np.array(values, np.float32)) == math.inf


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


def flat(contact: Bool) -> F32:
    """x, y and z of a flat skin, (3, rows, cols)."""
    return np.zeros((3, *contact.shape), np.float32)


def test_objects_are_numbered_by_area_and_small_ones_vanish() -> None:
    labels = label_objects(CONTACT, np.full(CONTACT.shape, 0.25, np.float32), flat(CONTACT))
    assert set(labels[1:4, 5:].ravel()) == {1}  # 2.25 mm²
    assert {int(labels[0, 0]), int(labels[0, 1]), int(labels[1, 0])} == {2}  # 0.75 mm²
    assert {int(labels[5, 1]), int(labels[6, 0])} == {3}  # 0.5 mm², corner to corner
    assert labels[3, 3] == 0  # 0.25 mm²
    assert labels.max() == 3
    np.testing.assert_array_equal(labels > 0, CONTACT & (np.arange(56).reshape(7, 8) != 27))


def test_no_more_objects_than_a_cloud_can_number() -> None:
    contact = np.zeros((2, 2 * (LABELS_MAX + 10)), bool)
    contact[0, ::2] = True
    labels = label_objects(contact, np.ones(contact.shape, np.float32), flat(contact))
    assert labels.max() == LABELS_MAX
    assert np.count_nonzero(labels) == LABELS_MAX


def over_the_whole_map(
    touched: Bool, height: F32, rays: DiscRays, geometry: Geometry
) -> Objects | None:
    """Plainly, every cell of the map and one object after the other."""
    points = skin_points(height, rays, geometry)
    du, dv = np.gradient(points, axis=1), np.gradient(points, axis=0)
    area = np.nan_to_num(np.linalg.norm(np.cross(du, dv), axis=-1)).astype(np.float64)
    count, patches = cv2.connectedComponents(touched.astype(np.uint8), connectivity=8)
    planes = np.moveaxis(points, -1, 0)
    count = part_objects(patches, count, planes, area.astype(np.float32), None)
    areas = {k: float(area[patches == k].sum()) for k in range(1, count)}
    large = sorted((k for k in areas if areas[k] >= MIN_OBJECT_MM2), key=lambda k: -areas[k])
    if not large:
        return None
    reported, clouds, labels = [], [], []
    for label, k in enumerate(large, start=1):
        mine = points[patches == k].astype(np.float64)
        x, y, z = (float(v) for v in mine.mean(axis=0))
        a, b, c = (float(v) for v in np.ptp(mine, axis=0))
        reported.append(
            TouchedObject(label, (x, y, z), (a, b, c), float(height[patches == k].max()), areas[k])
        )
        clouds.append(points[patches == k])
        labels.append(np.full(len(mine), label, np.uint16))
    contact = np.isin(patches, large)
    volume = float((height[contact] * area[contact]).sum())
    return Objects(
        contact,
        ObjectCloud(np.concatenate(clouds), np.concatenate(labels)),
        tuple(reported),
        volume,
    )


@given(
    st.integers(2, 30),
    st.integers(2, 30),
    st.sampled_from([None, 14.0]),
    st.floats(3.0, 60.0),
    st.lists(
        st.tuples(st.integers(0, 29), st.integers(0, 29), st.integers(1, 12), st.integers(1, 12)),
        max_size=5,
    ),
    st.sampled_from([0.01, 0.3, 3.0]),
    st.integers(0, 2**32 - 1),
)
@example(30, 30, 14.0, 60.0, [(0, 0, 30, 30)], 0.3, 1)  # the contact reaches the map's edges
@example(30, 30, 14.0, 10.0, [(0, 0, 30, 30)], 0.3, 1)  # and the disc's rim
@example(20, 25, 14.0, 12.0, [(3, 12, 2, 2), (9, 9, 5, 6), (16, 12, 1, 1)], 0.01, 2)
@example(20, 25, None, 60.0, [(5, 5, 1, 1)], 0.01, 3)  # too small
def test_objects_found_in_the_contacts_box_are_those_of_the_whole_map(
    rows: int,
    cols: int,
    distance_mm: float | None,
    radius_px: float,
    patches: list[tuple[int, int, int, int]],
    rough_mm: float,
    seed: int,
) -> None:
    geometry = Geometry(20.0, distance_mm, 50.0, Disc(rows / 2.1, cols / 1.9, radius_px))
    rays = disc_rays(Grid(rows, cols, 0.0, 0.0, 1.0), geometry)
    rng = np.random.default_rng(seed)
    height = np.where(rays.inside, rng.uniform(0, rough_mm, (rows, cols)), np.nan).astype(
        np.float32
    )
    touched = np.zeros((rows, cols), bool)
    for row, col, high, wide in patches:
        touched[row : row + high, col : col + wide] = True
    touched &= rays.inside
    found = find_objects(touched, height, None, rays, geometry)
    expected = over_the_whole_map(touched, height, rays, geometry)
    if found is None or expected is None:
        assert found is expected is None
        return
    np.testing.assert_array_equal(found.contact, expected.contact)
    np.testing.assert_array_equal(found.cloud.labels, expected.cloud.labels)
    assert found.cloud.points_mm.tobytes() == expected.cloud.points_mm.tobytes()
    assert len(found.described) == len(expected.described)
    for mine, other in zip(found.described, expected.described, strict=True):
        assert (mine.label, mine.extent_mm, mine.depth_max_mm) == (
            other.label,
            other.extent_mm,
            other.depth_max_mm,
        )
        # Sums in another order.
        assert mine.centroid_mm == pytest.approx(other.centroid_mm, rel=1e-12, abs=1e-12)
        assert mine.area_mm2 == pytest.approx(other.area_mm2, rel=1e-12)
    # Its products are of 32 bits.
    assert found.volume_mm3 == pytest.approx(expected.volume_mm3, rel=1e-6)
    assert found.cloud.points_mm.dtype == np.float32
    assert found.cloud.labels.dtype == np.uint16


def test_a_cloud_is_ordered_by_label() -> None:
    labels = np.array([[2, 0, 1], [1, 2, 0]], np.int32)
    assert cells_by_label(labels).tolist() == [2, 3, 0, 4]
    assert cells_by_label(0 * labels).size == 0
