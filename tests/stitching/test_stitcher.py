import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.bumpy_surface import APEX_MM, grid_poses, height_mm, misreported, press_of
from tacshade_edge.rigid import Rigid, shift
from tacshade_edge.stitching import stitcher as module
from tacshade_edge.stitching.press_points import NO_POINTS, PressPoints
from tacshade_edge.stitching.stitcher import FinishedMap, Stitcher

TRUE = grid_poses()
PRESSES = [press_of(pose, k) for k, pose in enumerate(TRUE)]


def stitched(poses: list[Rigid], presses: list[PressPoints] = PRESSES) -> Stitcher:
    stitcher = Stitcher(APEX_MM)
    for points, pose in zip(presses, poses, strict=True):
        stitcher.add(points, pose)
    return stitcher


def rms_mm(finished: FinishedMap) -> float:
    x, y, z = finished.raster.points().T
    return float(np.sqrt(np.mean((z - height_mm(x, y)) ** 2)))


def test_exact_poses_are_taken_as_exact() -> None:
    finished = stitched(TRUE).finish()
    assert not finished.refined
    assert 0 < finished.disagreement_mm < 0.1
    assert rms_mm(finished) < 0.06
    assert all(p.correction_mm == 0 and p.rejected is None for p in finished.presses)
    assert finished.presses[3].base_T_sensor is TRUE[3]


def with_depth_errors(seed: int, spread: float) -> list[PressPoints]:
    """As a network sees presses: each contact too deep or too shallow, most in its middle,
    by up to half a mm or so.
    """
    rng = np.random.default_rng(seed)
    presses = []
    for press in PRESSES:
        beside_mm = np.hypot(*press.points_mm[:, :2].T)
        points = press.points_mm.copy()
        points[:, 2] += spread * rng.standard_normal() * (1 - (beside_mm / 5.0) ** 2)
        presses.append(PressPoints(points, press.normals, press.confidence))
    return presses


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**31), spread=st.floats(0, 0.5))
def test_exact_poses_are_never_worse_refined(seed: int, spread: float) -> None:
    stitcher = stitched(TRUE, with_depth_errors(seed, spread))
    finished, plain = stitcher.finish(), stitcher.finish(None)
    assert not finished.refined
    np.testing.assert_array_equal(finished.raster.z_mm, plain.raster.z_mm)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_refinement_helps_beside_errors_of_depth(seed: int) -> None:
    stitcher = stitched(misreported(TRUE, seed, mm=0.5, deg=1.0), with_depth_errors(seed, 0.15))
    finished, plain = stitcher.finish(), stitcher.finish(None)
    assert finished.refined
    assert rms_mm(finished) < 0.8 * rms_mm(plain)


def test_noisy_poses_are_refined() -> None:
    stitcher = stitched(misreported(TRUE, 0))
    plain, finished = stitcher.finish(None), stitcher.finish()
    assert finished.refined
    assert not plain.refined
    assert finished.disagreement_mm > 0.2
    assert rms_mm(finished) < 0.6 * rms_mm(plain)
    assert max(p.correction_mm for p in finished.presses) > 0.3


def test_a_press_that_fits_nowhere_is_left_out() -> None:
    reported = list(TRUE)
    reported[24] = shift(0, 0, 2.5) @ reported[24]  # the robot slipped
    finished = stitched(reported).finish()
    assert [k for k, p in enumerate(finished.presses) if p.rejected] == [24]
    assert rms_mm(finished) < 0.06


@pytest.mark.slow
def test_a_point_that_fits_nowhere_counts_little() -> None:
    wild = PRESSES[24].points_mm.copy()
    wild[::50, 2] -= 3.0
    presses = list(PRESSES)
    presses[24] = PressPoints(wild, PRESSES[24].normals, PRESSES[24].confidence)
    clean, finished = rms_mm(stitched(TRUE).finish()), rms_mm(stitched(TRUE, presses).finish())
    assert finished < 1.5 * clean


def test_what_cannot_be_added(monkeypatch: pytest.MonkeyPatch) -> None:
    stitcher = Stitcher(APEX_MM)
    with pytest.raises(ValueError, match="without points"):
        stitcher.add(NO_POINTS, TRUE[0])
    monkeypatch.setattr(module, "POINTS_MAX", 1000)
    stitcher.add(PRESSES[0], TRUE[0])
    with pytest.raises(ValueError, match="exceed 1000 points"):
        stitcher.add(PRESSES[1], TRUE[1])
    assert stitcher.presses == 1
    assert not np.isfinite(Stitcher(APEX_MM).finish().raster.z_mm).any()
