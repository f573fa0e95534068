"""Objects that touch each other get numbers of their own; a single one of any shape stays one."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.sensor.contact.parting import (
    CONVEX_PART,
    PARTS_MAX,
    covered_part,
    k_means,
    part_objects,
    silhouette,
)
from tacshade_edge.types import F32, I32, Bool

CELLS = 80
CELL_MM = 0.3
ROWS, COLS = np.mgrid[:CELLS, :CELLS] * 1.0
AREA_MM2 = np.full((CELLS, CELLS), CELL_MM**2, np.float32)


def disc(row: float, col: float, radius: float) -> Bool:
    made: Bool = np.hypot(ROWS - row, COLS - col) <= radius
    return made


def box(row: float, col: float, half_rows: float, half_cols: float) -> Bool:
    made: Bool = (np.abs(ROWS - row) <= half_rows) & (np.abs(COLS - col) <= half_cols)
    return made


def skin() -> F32:
    """x, y and z of a round skin of 20 mm."""
    x, y = CELL_MM * (COLS - CELLS / 2), CELL_MM * (ROWS - CELLS / 2)
    return np.stack((x, y, np.sqrt(400 - x * x - y * y))).astype(np.float32)


def parted(contact: Bool, contact_logit: F32 | None = None) -> I32:
    count, raw = cv2.connectedComponents(contact.view(np.uint8), connectivity=8)
    assert part_objects(raw, count, skin(), AREA_MM2, contact_logit) == raw.max() + 1
    return np.asarray(raw, np.int32)


def logit(*objects: Bool) -> F32:
    """Log odds of contact as a network's: high inside each object, lower at its edge, blurred."""
    inside = [
        np.minimum(cv2.distanceTransform(one.view(np.uint8), cv2.DIST_L2, 5), 4) for one in objects
    ]
    return cv2.GaussianBlur(np.max(inside, axis=0) * 1.5, (0, 0), 1.0) - np.float32(0.5)


TOUCHING: dict[str, tuple[Bool, ...]] = {
    "two balls": (disc(40, 28, 10), disc(40, 47, 10)),
    "a small ball beside a cube": (box(40, 30, 14, 14), disc(40, 52, 8)),
    "three balls": (disc(30, 30, 9), disc(30, 47, 9), disc(45, 38.5, 9)),
    "four balls in a row": tuple(disc(40, 10 + 17 * k, 9) for k in range(4)),
}
SINGLE: dict[str, Callable[[], Bool]] = {
    "ball": lambda: disc(40, 40, 15),
    "bar": lambda: box(40, 40, 5, 30),
    "cross": lambda: box(40, 40, 5, 25) | box(40, 40, 25, 5),
    "L": lambda: box(40, 20, 25, 6) | box(60, 35, 6, 20),
    "T": lambda: box(20, 40, 6, 25) | box(40, 40, 25, 6),
    "crescent": lambda: disc(40, 40, 28) & ~disc(40, 50, 24),
    "ring": lambda: disc(40, 40, 25) & ~disc(40, 40, 17),
    "open ring": lambda: disc(40, 40, 25) & ~disc(40, 40, 17) & ~box(40, 60, 8, 10),
}


@pytest.mark.parametrize("name", TOUCHING)
@pytest.mark.parametrize("with_network", [False, True])
def test_objects_that_touch_are_parted_where_they_meet(name: str, with_network: bool) -> None:
    objects = TOUCHING[name]
    contact: Bool = np.logical_or.reduce(objects)
    raw = parted(contact, logit(*objects) if with_network else None)
    np.testing.assert_array_equal(raw > 0, contact)
    numbers = [np.bincount(raw[one]).argmax() for one in objects]
    assert sorted(numbers) == list(range(1, len(objects) + 1))
    for number, one in zip(numbers, objects, strict=True):
        assert np.mean(raw[one] == number) > 0.95


@pytest.mark.parametrize("name", SINGLE)
@pytest.mark.parametrize("with_network", [False, True])
def test_a_single_object_of_any_shape_stays_one(name: str, with_network: bool) -> None:
    contact = SINGLE[name]()
    assert parted(contact, logit(contact) if with_network else None).max() == 1


def test_a_valley_of_the_networks_odds_parts_what_its_outline_hardly_shows() -> None:
    objects = box(40, 28, 16, 14), disc(40, 54, 9)
    contact: Bool = np.logical_or(*objects) | box(40, 45, 7, 6)
    raw = parted(contact, logit(*objects))
    assert parted(contact).max() == 1
    assert raw.max() == 2
    assert raw[40, 20] != raw[40, 58]


@pytest.mark.parametrize("name", ["two balls", "three balls"])
@pytest.mark.parametrize("finer", [2, 5])
def test_objects_of_a_finer_map_are_parted_alike(name: str, finer: int) -> None:
    def fine(values: np.ndarray) -> np.ndarray:
        return np.repeat(np.repeat(values, finer, axis=-2), finer, axis=-1)

    objects = TOUCHING[name]
    contact: Bool = fine(np.logical_or.reduce(objects))
    count, raw = cv2.connectedComponents(contact.view(np.uint8), connectivity=8)
    area_mm2 = fine(AREA_MM2) / np.float32(finer**2)
    assert part_objects(raw, count, fine(skin()), area_mm2, None) == 1 + len(objects)
    np.testing.assert_array_equal(raw > 0, contact)
    for one in objects:
        assert np.bincount(raw[fine(one)]).max() > 0.95 * np.count_nonzero(fine(one))


@given(st.floats(8, 20), st.floats(8, 20), st.floats(0, np.pi))
def test_a_convex_contact_is_known_by_its_outline(a: float, b: float, turn: float) -> None:
    along = (COLS - 40) * np.cos(turn) + (ROWS - 40) * np.sin(turn)
    across = (ROWS - 40) * np.cos(turn) - (COLS - 40) * np.sin(turn)
    ellipse: Bool = (along / a) ** 2 + (across / b) ** 2 <= 1
    (contour,), _ = cv2.findContours(
        ellipse.view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    assert covered_part(np.asarray(contour, np.int32)) >= CONVEX_PART
    assert parted(ellipse).max() == 1


@given(
    st.lists(
        st.tuples(st.integers(0, 79), st.integers(0, 79), st.integers(1, 20), st.booleans()),
        min_size=1,
        max_size=8,
    ),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_any_contact_keeps_its_cells_and_every_part_is_of_one_contact(
    patches: list[tuple[int, int, int, bool]], with_network: bool, seed: int
) -> None:
    contact: Bool = np.logical_or.reduce(
        [
            disc(row, col, size) if is_round else box(row, col, size, size / 3)
            for row, col, size, is_round in patches
        ]
    )
    rng = np.random.default_rng(seed)
    noisy = rng.normal(0, 3, contact.shape).astype(np.float32) if with_network else None
    count, before = cv2.connectedComponents(contact.view(np.uint8), connectivity=8)
    raw = parted(contact, noisy)
    np.testing.assert_array_equal(raw > 0, contact)
    assert raw.max() < count + PARTS_MAX * count
    for number in range(1, raw.max() + 1):
        assert len(np.unique(before[raw == number])) == 1
    np.testing.assert_array_equal(parted(contact, noisy), raw)


def test_a_small_cluster_beside_a_large_one_ends_where_their_circles_meet() -> None:
    large, small = disc(40, 25, 20), disc(40, 53, 7)
    x = np.stack((COLS, ROWS), axis=-1)[large | small]
    truth = small[large | small]
    start = np.array([[25.0, 40.0], [53.0, 40.0]])
    assigned, centres = k_means(x, start, np.array([20.0, 7.0]))
    assert np.mean((assigned == 1) == truth) > 0.99
    np.testing.assert_allclose(centres, start, atol=0.5)
    plain, _ = k_means(x, start, np.zeros(2))
    assert np.mean((plain == 1) == truth) < 0.95


@given(st.integers(2, 5), st.integers(0, 2**32 - 1))
def test_the_silhouette_is_greatest_for_the_true_clusters(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    middles = 10.0 * np.arange(count)[:, None] * np.ones(3)
    x = (middles[:, None] + rng.uniform(-1, 1, (count, 30, 3))).reshape(-1, 3)
    assigned, centres = k_means(x, middles, np.zeros(count))
    assert silhouette(x, assigned, centres) > 0.8
    mixed = rng.permutation(assigned)
    assert silhouette(x, mixed, centres) < silhouette(x, assigned, centres)
