import math

import numpy as np
import pytest

from tacshade_edge.rigid import from_seven, turn
from tacshade_edge.simulator import pad as pads
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.skin import press_skin

RNG = np.random.default_rng(3)
PAD = pads.touchpad()
RADIUS_MM = 20.0


def on_top(count: int = 4000) -> np.ndarray:
    x, y = RNG.uniform((0, 0), (PAD.width_mm, PAD.length_mm), (count, 2)).T
    return np.stack((x, y, PAD.height_mm(x, y)), axis=1)


def test_the_top_is_the_solids_surface() -> None:
    points = on_top()
    assert np.abs(PAD.distance_mm(points)).max() < 1e-9
    assert (PAD.distance_mm(points + np.array((0, 0, 0.3))) > 0).all()
    assert (PAD.distance_mm(points - np.array((0, 0, 0.2))) < 0).all()


def test_distance_never_overestimates() -> None:
    points = RNG.uniform((0, 0, -1), (PAD.width_mm, PAD.length_mm, 6), (20000, 3))
    step = RNG.normal(0, 1, points.shape)
    change = np.abs(PAD.distance_mm(points + step) - PAD.distance_mm(points))
    assert np.all(change <= np.linalg.norm(step, axis=1) + 1e-9)


@pytest.mark.parametrize(
    ("bulge", "inside", "edge"),
    [
        (pads.Bar(0, 0, 10, 0, 2), (5, 0), (5, 1)),
        (pads.Arc(0, 0, 5, 2), (-5, 0), (0, -6)),
        (pads.Arc(0, 0, 5, 2, 0, 180), (0, 5), (5, -1)),
        (pads.Dot(1, 1, 2), (1, 1), (3, 1)),
    ],
)
def test_outlines(bulge: pads.Bulge, inside: tuple[float, float], edge: tuple[float, float]) -> None:
    x, y = np.array((inside, edge), float).T
    distance = bulge.outline(x, y)
    assert distance[0] <= -1
    assert distance[1] == pytest.approx(0, abs=1e-9)


def test_the_scan_covers_the_pad_at_one_depth() -> None:
    poses = pads.scan(PAD, 8.0, 2.0, RADIUS_MM)
    apex = np.stack([p.apply(np.array((0, 0, RADIUS_MM))) for p in poses])
    np.testing.assert_allclose(apex[:, 2], pads.BULGE_HEIGHT_MM - 2.0)
    assert (apex[:, :2].min(axis=0) == (0, 0)).all()
    np.testing.assert_allclose(apex[:, :2].max(axis=0), (PAD.width_mm, PAD.length_mm))
    assert np.linalg.norm(np.diff(apex, axis=0), axis=1).max() <= 8.0 + 1e-9


def test_the_skin_meets_what_lies_under_it() -> None:
    # Over the middle of the widest fence, tilted a little: the deepest place is the tip's, less the tilt's part.
    pose = pads.about_apex(
        from_seven((71.1, 22.0, pads.BULGE_HEIGHT_MM - 2.0 + RADIUS_MM, 0, 1, 0, 0)), turn((0.05, 0, 0)), RADIUS_MM
    )
    skin = press_skin(RADIUS_MM, 2.2, (Press(PAD.under(pose, RADIUS_MM), 0, 0, 0.0),))
    middle = skin.height_mm.shape[0] // 2
    assert skin.height_mm[middle, middle] == pytest.approx(2.0, abs=0.02)
    assert skin.height_mm.max() == pytest.approx(2.0, abs=0.1)


def test_noise_is_what_it_says() -> None:
    poses = pads.scan(PAD, 3.0, 2.0, RADIUS_MM)
    noisy = pads.disturbed(poses, RADIUS_MM, 0.3, 1.0, seed=1)
    apex = np.array((0, 0, RADIUS_MM))
    off = np.stack([n.apply(apex) - p.apply(apex) for n, p in zip(noisy, poses, strict=True)])
    np.testing.assert_allclose(off.std(axis=0), 0.3, rtol=0.1)
    angles = [
        math.acos(min(1.0, (np.trace(p.rotation.T @ n.rotation) - 1) / 2)) for n, p in zip(noisy, poses, strict=True)
    ]
    assert math.degrees(math.sqrt(np.mean(np.square(angles)))) == pytest.approx(1.0, rel=0.1)
    tilted = pads.varied(poses, RADIUS_MM, 0.4, 6.0, seed=1)
    off = np.stack([n.apply(apex) - p.apply(apex) for n, p in zip(tilted, poses, strict=True)])
    assert np.abs(off[:, :2]).max() < 1e-9
    assert 0.35 < np.abs(off[:, 2]).max() <= 0.4
