import numpy as np
import pytest

from tacshade_edge.rigid import from_seven
from tacshade_edge.simulator.pad import raster, scan
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.skin import press_skin
from tools.studies.drawn_pads import KINDS, SIDE_MM, relief

RADIUS_MM = 20.0


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_seed_gives_its_surface(kind: str) -> None:
    one, same, other = (raster(KINDS[kind](seed), 0.5) for seed in (4, 4, 5))
    np.testing.assert_array_equal(one, same)
    assert np.isfinite(one).all()
    assert one.max() <= KINDS[kind](4).top_mm + 1e-2
    assert (kind == "touchpad") == np.array_equal(one, other)


@pytest.mark.parametrize("seed", range(5))
def test_a_press_on_waves_meets_them_where_they_are(seed: int) -> None:
    surface = relief(seed)
    pose = min(
        scan(surface, 12.0, 2.0, RADIUS_MM), key=lambda p: float(np.hypot(*(p.translation_mm[:2] - SIDE_MM / 2)))
    )
    x, y = pose.translation_mm[:2]
    deep_mm = surface.top_mm - 2.0 - surface.height_mm(np.array(x), np.array(y))  # the undeformed tip's, over it
    skin = press_skin(RADIUS_MM, 2.2, (Press(surface.under(pose, RADIUS_MM), 0, 0, 0.0),))
    middle = skin.height_mm.shape[0] // 2
    assert skin.obstacle_mm[middle, middle] == pytest.approx(max(0.0, -float(deep_mm)), abs=0.01)


def test_distance_to_waves_never_overestimates() -> None:
    rng = np.random.default_rng(2)
    shape = relief(1).under(from_seven((18, 18, RADIUS_MM, 0, 1, 0, 0)), RADIUS_MM)
    points = rng.uniform(-15, 15, (5000, 3))
    step = rng.normal(0, 1, points.shape)
    change = np.abs(shape.sdf(points + step) - shape.sdf(points))
    assert np.all(change <= np.linalg.norm(step, axis=1) + 1e-9)
