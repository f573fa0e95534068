import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.contact.rigid_motion import TWIST_CELLS, RigidMotion, about_mean, normals, rigid_motions


def points(n: int, seed: int = 0) -> np.ndarray:
    """(3, N): scattered over some mm of a plane that leans."""
    x, y = np.random.default_rng(seed).uniform(-4, 4, (2, n)) + np.array([[3.0], [-2.0]])
    return np.stack((x, y, 18 - 0.2 * x + 0.1 * y)).astype(np.float32)


def moved(now: np.ndarray, shear: np.ndarray, *starts: int) -> tuple[RigidMotion, ...]:
    """Of objects whose points begin there."""
    first = np.array(starts or (0,))
    counts = np.diff(np.append(first, now.shape[1]))
    return rigid_motions(about_mean(now[:2], first, counts)[1], shear, first, counts)


@given(x_mm=st.floats(-5, 5), y_mm=st.floats(-5, 5), twist_deg=st.floats(-60, 60), count=st.integers(TWIST_CELLS, 400))
def test_a_rigid_motion_is_found_as_it_is(x_mm: float, y_mm: float, twist_deg: float, count: int) -> None:
    now = points(count)
    a = math.radians(twist_deg)
    middle = now[:2].astype(np.float64).mean(axis=1, keepdims=True)
    back = np.array(((math.cos(a), math.sin(a)), (-math.sin(a), math.cos(a))))
    before = back @ (now[:2] - middle) + middle - np.array([[x_mm], [y_mm]])
    (motion,) = moved(now, (now[:2] - before).astype(np.float32))
    assert motion.shear_mm == pytest.approx((x_mm, y_mm), abs=1e-4)
    assert motion.twist_deg == pytest.approx(twist_deg, abs=0.01)
    assert motion.strain_mm < 1e-3


def test_from_x_towards_y_is_positive() -> None:
    now = np.array([[1.0, 0, -1, 0, 2, -2], [0.0, 1, 0, -1, 0, 0], [20.0] * 6], np.float32)
    shear = 0.1 * np.stack((-now[1], now[0]))
    assert moved(now, shear)[0].twist_deg == pytest.approx(math.degrees(math.atan(0.1)), abs=0.01)


def test_each_object_has_its_own() -> None:
    now = np.concatenate((points(40, 1), points(5, 2), points(1, 3)), axis=1)
    shear = np.repeat(np.array([[1.0, -2.0, 0.5], [0.0, 3.0, 0.25]], np.float32), (40, 5, 1), axis=1)
    motions = moved(now, shear, 0, 40, 45)
    assert [motion.shear_mm for motion in motions] == [(1.0, 0.0), (-2.0, 3.0), (0.5, 0.25)]
    assert [motion.twist_deg is None for motion in motions] == [False, True, True]
    assert all(math.isfinite(value) for motion in motions for value in (*motion.shear_mm, motion.strain_mm))


def test_what_stretches_is_strained() -> None:
    now = points(100)
    stretched = 0.2 * (now[:2] - now[:2].mean(axis=1, keepdims=True))
    spread = float(np.sqrt(np.mean(np.sum(stretched.astype(float) ** 2, axis=0))))
    assert moved(now, stretched)[0].strain_mm == pytest.approx(spread, rel=1e-3)


def test_the_normal_of_each_object_points_away_from_the_camera() -> None:
    first, second = points(40, 1), points(7, 2)[[1, 0, 2]]
    now = np.concatenate((first, second, points(1, 3)), axis=1)
    starts = np.array([0, 40, 47])
    found = normals(about_mean(now, starts, np.array([40, 7, 1]))[1], starts)
    expected = np.array(((0.2, -0.1, 1), (-0.1, 0.2, 1))) / math.sqrt(1.05)
    np.testing.assert_allclose(found[:2], expected, atol=1e-4)
    assert np.linalg.norm(found[2]) == pytest.approx(1.0)
    assert found[2, 2] >= 0
