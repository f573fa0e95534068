"""Simulated imprints: of presses like the table's, and of another shape at the same numbers."""

from __future__ import annotations

import numpy as np
import pytest

from tacshade_edge.core.touch.imprint import belongs, imprint_of, terms
from tacshade_edge.core.touch.learning import learn
from tacshade_edge.types import F32, F64, TouchedObject, TouchModel


def presses(rows: int, seed: int, roundness: float) -> tuple[F32, F32, F64]:
    """Features, imprints and depths of a ball on a dome: the rounder, the smaller at the same depth."""
    random = np.random.default_rng(seed)
    depth_mm = random.uniform(0.5, 3, rows)
    imprints = np.zeros((rows, 4))
    imprints[:, 0] = depth_mm
    imprints[:, 1] = imprints[:, 3] = np.sqrt(20 * depth_mm / (1 + roundness))
    imprints[:, 2] = np.cbrt(imprints[:, 1] ** 2 * depth_mm / 2)
    imprints += 0.05 * random.normal(size=imprints.shape)
    features = np.outer(depth_mm, np.linspace(0.5, 1, 30)) + 0.1 * random.normal(size=(rows, 30))
    return features.astype(np.float32), imprints.astype(np.float32), depth_mm[:, None]


@pytest.fixture(scope="module")
def model() -> TouchModel:
    features, imprints, labels = presses(120, 1, 0.0)
    found = learn(features, imprints, ("depth_mm",), labels, np.arange(120), "n").model
    assert found is not None
    return found


@pytest.mark.parametrize(("roundness", "least", "most"), [(0.0, 0.97, 1.0), (1.0, 0.0, 0.05), (4.0, 0.0, 0.0)])
def test_imprints_of_the_table_s_shape_belong_and_others_do_not(
    model: TouchModel, roundness: float, least: float, most: float
) -> None:
    _, imprints, depth_mm = presses(200, 2, roundness)
    part = np.mean([belongs(model, *one) for one in zip(depth_mm, imprints, strict=True)])
    assert least <= part <= most


def test_terms_are_one_the_parts_of_the_range_and_their_products() -> None:
    low, high = np.float32([0, -10, 4]), np.float32([4, 10, 4])
    found = terms(np.array([[4.0, -5.0, 4.0]]), low, high)
    np.testing.assert_array_equal(found, [[1, 1, -0.5, 0, 1, -0.5, 0, 0.25, 0, 0]])


def test_an_imprint_is_of_all_that_touches_and_its_length_the_greatest_object_s() -> None:
    first = TouchedObject(1, (0.0, 0.0, 19.0), (3.0, 4.0, 0.5), 1.0, 9.0)
    second = TouchedObject(2, (5.0, 0.0, 19.0), (1.0, 1.0, 0.5), 1.5, 7.0)
    np.testing.assert_allclose(imprint_of((first, second), 8.0), [1.5, 4, 2, 5], rtol=1e-6)
