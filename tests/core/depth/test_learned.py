import numpy as np
import pytest
from support.calibrated_sensor import HALF, calibrated, unloaded
from support.networks import answering

from tacshade_edge.core.depth.learned import KNOWN, LearnedInverse, LearnedSolver, fold, unfold
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.types import F32, Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(61.3, 83.9, 47.7))
UNIT_MM = 20 * np.sin(np.radians(50))


@pytest.mark.parametrize("by", [2, 4])
def test_folding_is_undone_by_unfolding(by: int) -> None:
    maps = np.random.default_rng(by).random((2, 24, 24), dtype=np.float32)
    folded = fold(maps, by)
    assert folded.shape == (2 * by * by, 24 // by, 24 // by)
    np.testing.assert_array_equal(unfold(folded, by), maps)


def test_folding_keeps_neighbours_together() -> None:
    maps = np.arange(2 * 6 * 6, dtype=np.float32).reshape(2, 6, 6)
    folded = fold(maps, 2)
    assert folded[:4, 1, 2].tolist() == [maps[0, 2, 4], maps[0, 2, 5], maps[0, 3, 4], maps[0, 3, 5]]


@pytest.mark.parametrize("by", [2, 4])
def test_the_network_gets_frame_reference_and_what_is_known_and_its_answer_becomes_mm(by: int) -> None:
    rng = np.random.default_rng(0)
    white, reference = rng.random((2, disc_map.CELLS, disc_map.CELLS), dtype=np.float32)
    sensed: list[F32] = []
    n = by * by

    def sense(known: F32) -> F32:
        sensed.append(known)
        return known[:n] + 1

    made = LearnedInverse(
        answering(by, sense, lambda seen, sensor: np.concatenate((seen, sensor))), GEOMETRY, 6.0, reference
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


def test_one_frame_does_not_change_the_next() -> None:
    network = answering(2, lambda known: known[:4], lambda white, sensor: np.concatenate((white, sensor)))
    inverse = LearnedInverse(network, GEOMETRY, 6.0, np.zeros((disc_map.CELLS,) * 2, np.float32))
    dark, bright = np.zeros((disc_map.CELLS,) * 2, np.float32), np.ones((disc_map.CELLS,) * 2, np.float32)
    first = inverse(dark)
    before = first.height_mm.tobytes()
    inverse(bright)
    assert first.height_mm.tobytes() == before == inverse(dark).height_mm.tobytes()


def test_shear_is_in_mm_on_the_maps_cells_and_finite() -> None:
    network = answering(4, lambda known: known[:16], lambda white, sensor: np.concatenate((white, sensor)))
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
    assert shear[56:60, 56:60, 0].max() < 0.03 * unit_mm  # what was not finite is 0 between its neighbours
