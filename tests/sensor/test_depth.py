"""σ against its formula in float64, and at the extremes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from support.calibrated_sensor import HALF, calibrated, pressed, unloaded
from support.networks import answering
from tacshade_edge.sensor.depth import Depth, with_own_ratio
from tacshade_edge.sensor.depth.hybrid_iteration import HybridIteration
from tacshade_edge.sensor.depth.hybrid_sfs import hybrid_depth, unit_by_grey
from tacshade_edge.sensor.depth.learned import KNOWN, LearnedInverse, LearnedSolver, fold, unfold
from tacshade_edge.sensor.depth.sigma import TERMS, SigmaModel, sigma_of_scale_1, terms
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc_map import REACH
from tacshade_edge.sensor.image.preprocess import GreyMaps, Preprocessor
from tacshade_edge.sensor.profiles import PAPER_WITHOUT_EQ_11, PROFILES, Profile
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F32, F64, Bool, Disc, Frame, Geometry

ALPHA_MM = 3.0
METHODS: dict[str, Callable[[GreyMaps, float], Depth]] = {
    "paper": lambda maps, alpha_mm: hybrid_depth(maps, alpha_mm, HybridIteration(maps.g_d.shape)),
    "without eq. 11": lambda maps, alpha_mm: hybrid_depth(maps, alpha_mm, unit_by_grey),
}
"""From grey maps to depth: with eq. 11 and without."""


def bump(rows: int = 40, cols: int = 50, top: float = 80.0) -> F32:
    y, x = np.mgrid[:rows, :cols]
    return (top * np.exp(-((y - rows / 2) ** 2 + (x - cols / 2) ** 2) / 60)).astype(np.float32)


def solve(solver: str, g_d: F32, *, inside: bool = True) -> Depth:
    g0 = np.full(g_d.shape, 120, np.float32)
    maps = GreyMaps(g=g0 + g_d, g0=g0, g_d=g_d, inside=np.full(g_d.shape, inside))
    return METHODS[solver](maps, ALPHA_MM)


@pytest.mark.parametrize("solver", METHODS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_bad_input_is_repaired_and_counted(solver: str, bad: float) -> None:
    good, g_d = bump(), bump()
    g_d[3, 4] = bad
    depth, unharmed = solve(solver, g_d), solve(solver, good)
    assert np.isfinite(depth.height_mm).all()
    assert unharmed.repaired_px == 0
    assert depth.repaired_px == 1
    # One bad cell far from the contact does not take the contact away.
    assert depth.height_mm.max() == pytest.approx(unharmed.height_mm.max(), rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("profile", [PROFILES["paper"], PAPER_WITHOUT_EQ_11])
def test_a_press_of_known_depth_is_as_deep_with_its_own_ratio(profile: Profile) -> None:
    """α of one press: "the ratio between the ground-truth contact depth
    and the maximum estimated depth".
    """
    press = pressed("ball", 3.0)
    depth_mm = float(np.nanmax(press.truth().height_mm))
    made = Reconstructor(with_own_ratio(calibrated(HALF, 0), depth_mm), profile)
    result = made.step(Frame(0, 0, 0, press.image))
    assert result.contact
    assert result.profile == profile.name
    assert result.depth_max_mm == pytest.approx(depth_mm, rel=1e-6)


def test_without_eq_11_the_height_is_the_grey_image() -> None:
    g_d = bump()
    found = solve("without eq. 11", g_d).height_mm
    np.testing.assert_allclose(
        found, ALPHA_MM * (g_d - g_d.min()) / (g_d.max() - g_d.min()), atol=1e-6
    )


GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(61.3, 83.9, 47.7))
UNIT_MM = 20 * np.sin(np.radians(50))


@pytest.mark.parametrize("by", [2, 4])
def test_folding_is_undone_by_unfolding(by: int) -> None:
    maps = np.random.default_rng(by).random((2, 24, 24), dtype=np.float32)
    folded = fold(maps, by)
    assert folded.shape == (2 * by * by, 24 // by, 24 // by)
    np.testing.assert_array_equal(unfold(folded, by), maps)


@pytest.mark.parametrize("by", [2, 4])
def test_the_network_gets_frame_reference_and_what_is_known_and_its_answer_becomes_mm(
    by: int,
) -> None:
    rng = np.random.default_rng(0)
    white, reference = rng.random((2, disc_map.CELLS, disc_map.CELLS), dtype=np.float32)
    sensed: list[F32] = []
    n = by * by

    def sense(known: F32) -> F32:
        sensed.append(known)
        return known[:n] + 1

    made = LearnedInverse(
        answering(by, sense, lambda seen, sensor: np.concatenate((seen, sensor))),
        GEOMETRY,
        6.0,
        reference,
    )
    answers = [made(white), made(white)]
    (known,) = sensed  # once for a sensor
    assert known.shape == (n + KNOWN, disc_map.CELLS // by, disc_map.CELLS // by)
    assert known.dtype == np.float32
    np.testing.assert_array_equal(unfold(known[:n], by)[0], reference)
    np.testing.assert_array_equal(known[n:], disc_map.geometry_maps(GEOMETRY, 6.0)[:, ::by, ::by])
    for answer in answers:
        np.testing.assert_allclose(answer.height_mm, white * UNIT_MM / 10, rtol=1e-6)
        np.testing.assert_array_equal(answer.contact_logit, reference + 1)
    with pytest.raises(ValueError, match="read-only"):
        answers[0].height_mm[0, 0] = 1


def test_shear_is_in_mm_on_the_maps_cells_and_finite() -> None:
    network = answering(
        4, lambda known: known[:16], lambda white, sensor: np.concatenate((white, sensor))
    )
    preprocessor = Preprocessor(calibrated(HALF, 0), PROFILES["balanced"])
    solver = LearnedSolver(preprocessor, network)
    preprocessed = preprocessor.preprocess(preprocessor.grey(unloaded(HALF)))
    shear = solver.shear_mm(preprocessed)
    assert shear is not None
    assert shear.shape == (disc_map.CELLS, disc_map.CELLS, 2)
    geometry = HALF.geometry
    unit_mm = geometry.skin_radius_mm * np.sin(np.radians(geometry.visible_half_angle_deg))
    assert np.median(shear[..., 0]) == pytest.approx(0.03 * unit_mm, rel=1e-6)
    assert (shear[..., 1] == 0).all()
    assert np.isfinite(shear).all()
    assert (
        shear[56:60, 56:60, 0].max() < 0.03 * unit_mm
    )  # what was not finite is 0 between its neighbours


CELLS, COARSE = 16, 4
SENSOR = Geometry(25.0, 40.0, 60.0, Disc(100.0, 120.0, 80.0))
MODEL = SigmaModel((-1.2, 0.8, -0.3, -0.06, 0.04), 2.0, 0.2, 0.6)
FLOATS = st.floats(width=32, allow_nan=True, allow_infinity=True)


def by_the_formula(h: F32, contact: F32, untrusted: F32, where: Bool) -> F64:
    """Cell by cell, in float64."""
    k, wide = SENSOR.skin_radius_mm / 20, np.pad(h.astype(np.float64), 1, mode="edge")
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
        found.append(
            k * math.exp(math.fsum(w * value for w, value in zip(MODEL.weights, x, strict=True)))
        )
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
        found = sigma_of_scale_1(MODEL, terms(h, contact, untrusted, some, SENSOR), SENSOR)
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, by_the_formula(h, contact, untrusted, some), rtol=1e-5)
    found = sigma_of_scale_1(MODEL, terms(h, contact, untrusted, where, SENSOR), SENSOR)
    np.testing.assert_allclose(found, by_the_formula(h, contact, untrusted, where), rtol=1e-5)


@given(
    npst.arrays(np.float32, (CELLS, CELLS), elements=st.floats(0, 25, width=32)),
    npst.arrays(np.float32, (CELLS, CELLS), elements=FLOATS),
    npst.arrays(np.float32, (COARSE, COARSE), elements=FLOATS),
    npst.arrays(np.bool_, (CELLS, CELLS)),
)
def test_whatever_a_network_says_it_is_finite_and_above_0(
    h: Any, contact: Any, untrusted: Any, where: Any
) -> None:
    found = sigma_of_scale_1(MODEL, terms(h, contact, untrusted, where, SENSOR), SENSOR)
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
    with pytest.raises(
        ValueError, match="expected finite numbers, a weight for each of constant, height"
    ):
        SigmaModel(*changed)
