"""σ against its formula in float64, and at the extremes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from tacshade_edge.core.depth.sigma import TERMS, SigmaModel, sigma_of_scale_1, terms
from tacshade_edge.core.geometry.disc_map import REACH
from tacshade_edge.types import F32, F64, Bool, Disc, Geometry

CELLS, COARSE = 16, 4
GEOMETRY = Geometry(25.0, 40.0, 60.0, Disc(100.0, 120.0, 80.0))
MODEL = SigmaModel((-1.2, 0.8, -0.3, -0.06, 0.04), 2.0, 0.2, 0.6)
FLOATS = st.floats(width=32, allow_nan=True, allow_infinity=True)


def by_the_formula(h: F32, contact: F32, untrusted: F32, where: Bool) -> F64:
    """Cell by cell, in float64."""
    k, wide = GEOMETRY.skin_radius_mm / 20, np.pad(h.astype(np.float64), 1, mode="edge")
    cell_mm = 2 * REACH * 25.0 * math.sin(math.radians(60.0)) / CELLS
    smooth = np.array([1.0, 2.0, 1.0])
    found = []
    for i, j in zip(*np.nonzero(where), strict=True):
        near = wide[i : i + 3, j : j + 3]
        along = (near[:, 2] - near[:, 0]) @ smooth / (8 * cell_mm)
        across = (near[2] - near[0]) @ smooth / (8 * cell_mm)
        x = (
            1.0,
            math.log(0.1 + float(h[i, j]) / k),
            min(math.hypot(along, across), 2.0),
            min(max(float(contact[i, j]), -2.0), 8.0),
            min(max(float(untrusted[i // 4, j // 4]), -12.0), 0.0),
        )
        found.append(k * math.exp(math.fsum(w * value for w, value in zip(MODEL.weights, x, strict=True))))
    return np.array(found)


def test_it_is_the_formula() -> None:
    rng = np.random.default_rng(3)
    h = np.abs(rng.normal(0, 3, (CELLS, CELLS))).astype(np.float32)
    contact, untrusted = (rng.normal(0, 8, (n, n)).astype(np.float32) for n in (CELLS, COARSE))
    where = rng.random((CELLS, CELLS)) < 0.5
    where[0, 0] = where[-1, -1] = True
    for rows in (slice(None), slice(0, 5), slice(7, 11)):  # of the whole map, or of a contact in it
        some = np.zeros_like(where)
        some[rows, 2:13] = where[rows, 2:13]
        found = sigma_of_scale_1(MODEL, terms(h, contact, untrusted, some, GEOMETRY), GEOMETRY)
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, by_the_formula(h, contact, untrusted, some), rtol=1e-5)
    found = sigma_of_scale_1(MODEL, terms(h, contact, untrusted, where, GEOMETRY), GEOMETRY)
    np.testing.assert_allclose(found, by_the_formula(h, contact, untrusted, where), rtol=1e-5)


@given(
    npst.arrays(np.float32, (CELLS, CELLS), elements=st.floats(0, 25, width=32)),
    npst.arrays(np.float32, (CELLS, CELLS), elements=FLOATS),
    npst.arrays(np.float32, (COARSE, COARSE), elements=FLOATS),
    npst.arrays(np.bool_, (CELLS, CELLS)),
)
def test_whatever_a_network_says_it_is_finite_and_above_0(h: Any, contact: Any, untrusted: Any, where: Any) -> None:
    found = sigma_of_scale_1(MODEL, terms(h, contact, untrusted, where, GEOMETRY), GEOMETRY)
    assert found.shape == (np.count_nonzero(where),)
    assert np.isfinite(found).all()
    assert (found > 0).all()


@pytest.mark.parametrize(
    "changed",
    [
        ((1.0,) * (len(TERMS) - 1), 1.0, 0.0, 1.0),
        ((math.nan, *MODEL.weights[1:]), 1.0, 0.0, 1.0),
        (MODEL.weights, 0.0, 0.0, 1.0),
        (MODEL.weights, 1.0, math.inf, 1.0),
    ],
)
def test_what_is_no_model_is_refused(changed: Any) -> None:
    with pytest.raises(ValueError, match="expected finite numbers, a weight for each of constant, height"):
        SigmaModel(*changed)
