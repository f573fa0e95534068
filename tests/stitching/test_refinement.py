import numpy as np
import pytest

from support.bumpy_surface import APEX_MM, DOWN, grid_poses, misreported, press_of
from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.stitching.refinement import (
    PoseError,
    correction,
    moved_by_part,
    overlap_cells,
    refine_poses,
    robots_part,
    thin_points,
)
from tacshade_edge.types import F64

APEX = np.array((0, 0, APEX_MM))
TRUE = grid_poses()
PRESSES = [thin_points(press_of(pose, k)) for k, pose in enumerate(TRUE)]


def test_points_of_a_plane_agree_in_every_cell() -> None:
    x, y = np.random.default_rng(0).uniform(-10, 10, (2, 4000))
    at = np.stack((x, y, 3 + 0.2 * x - 0.1 * y), axis=1)
    cells = overlap_cells(at, np.ones(len(at)), 1.0)
    inside = (np.abs(at[:, :2]) < 8).all(axis=1)
    assert cells.slope[inside] == pytest.approx(
        np.broadcast_to((0.2, -0.1), (inside.sum(), 2)), abs=0.1
    )
    assert cells.height_mm[inside] == pytest.approx(at[inside, 2], abs=0.2)
    assert cells.count == 400


def apex_errors(poses: list[Rigid]) -> F64:
    return np.stack([p.apply(APEX) - t.apply(APEX) for p, t in zip(poses, TRUE, strict=True)])


def part_of(reported: list[Rigid], presses: list[F64] = PRESSES) -> float:
    return robots_part(presses, reported, refine_poses(presses, reported, APEX, PoseError()), APEX)


def rms(values: F64) -> F64:
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def test_overlaps_correct_pose_noise() -> None:
    reported = misreported(TRUE, 0)
    before, after = (
        rms(apex_errors(reported)),
        rms(apex_errors(refine_poses(PRESSES, reported, APEX, PoseError()))),
    )
    assert after[2] < 0.35 * before[2]
    assert (after[:2] < 0.8 * before[:2]).all()


def test_exact_poses_stay() -> None:
    poses = refine_poses(PRESSES, TRUE, APEX, PoseError())
    assert rms(apex_errors(poses)).max() < 0.05


def test_the_map_does_not_bend() -> None:
    # A tilt of the whole map and its height come from the mean of all reports,
    # whatever the overlaps say.
    reported = misreported(TRUE, 3)
    errors, places = (
        apex_errors(refine_poses(PRESSES, reported, APEX, PoseError())),
        np.stack([p.apply(APEX) for p in TRUE]),
    )
    fit = np.column_stack((places[:, :2] - places[:, :2].mean(axis=0), np.ones(len(TRUE))))
    tilt_x, tilt_y, lift = np.linalg.lstsq(fit, errors[:, 2], rcond=None)[0]
    assert abs(lift) < 3 * 0.3 / np.sqrt(len(TRUE))
    assert max(abs(tilt_x), abs(tilt_y)) * 30 < 0.3
    quadratic = np.column_stack((fit, (fit[:, :2] / 15) ** 2))
    assert np.abs(np.linalg.lstsq(quadratic, errors[:, 2], rcond=None)[0][3:]).max() < 0.2


def test_the_frame_does_not_matter() -> None:
    # The same presses on the same table, which stands a metre away: turned about the vertical.
    base = shift(1000, -500, 30) @ turn((0, 0, 0.8))
    reported = misreported(TRUE, 4)
    here = refine_poses(PRESSES, reported, APEX, PoseError())
    there = refine_poses(PRESSES, [base @ t for t in reported], APEX, PoseError())
    # Cells lie elsewhere, so it is the same within what cells do.
    off = np.stack(
        [(base @ h).apply(APEX) - t.apply(APEX) for h, t in zip(here, there, strict=True)]
    )
    assert rms(off).max() < 0.1


def test_what_overlaps_nothing_stays() -> None:
    alone = [shift(200.0 * k, 0, APEX_MM) @ DOWN for k in range(3)]
    presses = [thin_points(press_of(pose, k)) for k, pose in enumerate(alone)]
    for reported, found in zip(alone, refine_poses(presses, alone, APEX, PoseError()), strict=True):
        correction_mm, correction_deg = correction(reported, found, APEX)
        assert correction_mm < 0.02
        assert correction_deg < 0.2
    assert refine_poses(presses[:1], alone[:1], APEX, PoseError()) == alone[:1]
    assert part_of(alone, presses) == 0


@pytest.mark.slow
def test_the_robots_part_grows_with_its_error() -> None:
    parts = [part_of(misreported(TRUE, 5, mm, 2 * mm)) for mm in (0.1, 0.3, 0.6)]
    assert part_of(TRUE) == 0
    assert parts == sorted(parts)
    assert 0.3 < parts[0] < parts[2] < 1


def test_a_part_of_the_way() -> None:
    far = (
        shift(0, 0.3, 0.4)
        @ TRUE[5]
        @ shift(0, 0, APEX_MM)
        @ turn((0.02, 0.01, 0))
        @ shift(0, 0, -APEX_MM)
    )
    whole = correction(TRUE[5], far, APEX)
    for part in (0.0, 0.4, 1.0):
        there = moved_by_part(TRUE[5], far, part, APEX)
        np.testing.assert_allclose(
            correction(TRUE[5], there, APEX), part * np.array(whole), atol=1e-5
        )
    np.testing.assert_allclose(
        moved_by_part(TRUE[5], far, 1.0, APEX).rotation, far.rotation, atol=1e-9
    )
