from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from tacshade_edge.calibration.indenters import (
    bar,
    box,
    cone,
    cylinder,
    mesh,
    place,
)
from tacshade_edge.calibration.printable_indenters import (
    LENGTH_MM,
    STEM_RADIUS_MM,
    Printable,
    planned_presses,
    printables,
)
from tacshade_edge.sensor.geometry.disc import Grid, disc_rays
from tacshade_edge.types import Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(60.0, 60.0, 56.0))
RAYS = disc_rays(Grid(121, 121, 0, 0, 1), GEOMETRY)
PRINTED = {"cylinder": cylinder, "box": box, "bar": bar, "cone": cone}
NAMES = [each.name for each in printables()]


def named(name: str) -> Printable:
    return next(each for each in printables() if each.name == name)


@pytest.mark.parametrize("name", NAMES)
def test_it_is_a_solid_that_a_printer_can_fill(name: str) -> None:
    """Every edge has two faces, which run along it in opposite directions,
    and the faces point outwards.
    """
    triangles = named(name).triangles_mm
    corners = np.round(triangles, 9) + 0.0
    edges: Counter[tuple[bytes, bytes]] = Counter()
    for triangle in corners:
        points = [point.tobytes() for point in triangle]
        edges.update(zip(points, points[1:] + points[:1], strict=True))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)
    volume_mm3 = (
        float(
            np.einsum("ij,ij->i", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum()
        )
        / 6
    )
    assert volume_mm3 > np.pi * STEM_RADIUS_MM**2 * LENGTH_MM / 2
    assert triangles[..., 2].min() == 0
    assert triangles[..., 2].max() == LENGTH_MM


@pytest.mark.parametrize("name", [name for name in NAMES if not name.startswith("ball")])
def test_it_presses_as_its_entry_says(name: str) -> None:
    printable = named(name)
    shape, *sizes = printable.entry.values()
    known = PRINTED[str(shape)](name, *map(float, sizes))  # type: ignore[operator]
    for depth_mm in (1.0, 4.5):
        printed, stated = (
            place(each, 20.0, 2.0, -1.0, depth_mm, 30.0).height_mm(RAYS, GEOMETRY)
            for each in (mesh(name, printable.triangles_mm), known)
        )
        both = np.isfinite(printed) & np.isfinite(stated)
        assert both.sum() > 20
        assert (np.isfinite(printed) ^ np.isfinite(stated)).sum() <= 0.05 * both.sum() + 8
        np.testing.assert_allclose(printed[both], stated[both], atol=0.02)


@pytest.mark.parametrize("name", [name for name in NAMES if name.startswith("ball")])
def test_a_ball_is_round_where_it_presses(name: str) -> None:
    printable = named(name)
    radius_mm = float(printable.entry["radius_mm"])
    low = printable.triangles_mm.reshape(-1, 3)
    low = low[low[:, 2] < radius_mm]
    np.testing.assert_allclose(
        np.linalg.norm(low - (0, 0, radius_mm), axis=1), radius_mm, atol=1e-9
    )


def test_the_plan_has_every_indenter_at_every_depth_and_all_over_the_disc() -> None:
    presses = planned_presses()
    for name in NAMES:
        own = [press for press in presses if press.name == name]
        assert len({press.depth_mm for press in own}) == len(own) == 5
        assert max(np.hypot(press.x_mm, press.y_mm) for press in own) > 6
    places = np.array([(press.x_mm, press.y_mm) for press in presses])
    assert (np.linalg.norm(places, axis=1) <= 9.05).all()
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1) + 99 * np.eye(len(places))
    assert apart.min() > 1.5
    assert np.abs(places.mean(axis=0)).max() < 0.5
