"""The third family: its mesh, its objects, the way from a mesh to a skin, and the engine where there is one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.truth import shear_mm, skin_points
from tacshade_edge.types import F64
from tools.studies.third_family import dome as domes
from tools.studies.third_family import evaluate
from tools.studies.third_family.dome import Dome, cap, drawn, meshed, volumes
from tools.studies.third_family.paths import ROUNDING_MM, SOLIDS, deepest_mm, plate_depth_mm, ways
from tools.studies.third_family.presses import KINDS, described, known_ways
from tools.studies.third_family.seen import deformed, renderer, seen_truth

DOME = Dome(radius_mm=20.0, skin_mm=1.5, gel_part=0.3, stiffness_ratio=3.0, poisson=0.43, friction=0.8)


def test_tetrahedra_fill_the_dome_and_stand_right() -> None:
    mesh = meshed(DOME, 2.0)
    skin, gel = volumes(mesh.points_mm, mesh.skin), volumes(mesh.points_mm, mesh.gel)
    assert min(skin.min(), gel.min()) > 0
    part = 2 * np.pi / 3 * (1 - np.cos(np.radians(72)))
    outer, between, inner = DOME.radius_mm, DOME.radius_mm - 1.5, 0.7 * DOME.radius_mm - 1.5
    assert skin.sum() == pytest.approx(part * (outer**3 - between**3), rel=0.05)
    assert gel.sum() == pytest.approx(part * (between**3 - inner**3), rel=0.05)
    np.testing.assert_allclose(np.linalg.norm(mesh.points_mm[: mesh.surface], axis=1), DOME.radius_mm)
    assert mesh.clamped[-mesh.surface :].all()
    assert not mesh.clamped[0]


def test_the_ranges_are_disjoint_in_every_parameter() -> None:
    working, final = domes.RANGES["working"], domes.RANGES["final"]
    assert working.keys() == final.keys()
    for name, (low, high) in working.items():
        other_low, other_high = final[name]
        assert low < high <= other_low < other_high, name
    assert drawn("working", 3) == drawn("working", 3)
    assert drawn("working", 3) != drawn("final", 3)


def test_presses_are_stated_as_they_are_made() -> None:
    made = known_ways(DOME, 7, 12)
    assert [way.object_name for way in made[:6]] == [name for name, _ in KINDS]
    assert all(0.6 <= way.press.depth_mm <= deepest_mm(DOME) for way in made)
    assert all(way.press.drag_x_mm == way.press.drag_y_mm == way.press.twist_deg == 0 for way in made)
    for way, (_, size_mm) in zip(made, KINDS + KINDS, strict=True):
        radius_mm, known = described(way)
        (kind, sizes, _, _), scale = SOLIDS[way.object_name][0], way.press.scale
        own_mm = (sizes[0] + ROUNDING_MM) * scale
        assert (2 * own_mm if kind == "box" else own_mm) == pytest.approx(size_mm)
        assert (known is None) == (radius_mm > 0) == (kind == "sphere")
        if known is not None:
            across_mm = np.ptp(known.triangles_mm.reshape(-1, 3)[:, 0])
            assert across_mm == pytest.approx(2 * own_mm, rel=0.01)


def _to_solid_mm(name: str, points: F64) -> F64:
    """Distance of points to the engine's solids, from their definitions."""
    nearest = np.full(len(points), np.inf)
    for kind, sizes, middle, turned in SOLIDS[name]:
        p = points - np.array(middle)
        if kind == "sphere":
            far = np.linalg.norm(p, axis=1) - sizes[0]
        elif kind == "box":
            far = np.linalg.norm(np.maximum(np.abs(p) - np.array(sizes), 0), axis=1)
        elif kind == "capsule":
            assert turned == (0, 90, 0)
            p[:, 0] -= np.clip(p[:, 0], -sizes[1], sizes[1])
            far = np.linalg.norm(p, axis=1) - sizes[0]
        else:
            rim = np.maximum(np.hypot(p[:, 0], p[:, 1]) - sizes[0], 0)
            far = np.hypot(rim, np.maximum(np.abs(p[:, 2]) - sizes[1], 0))
        nearest = np.minimum(nearest, far)
    return nearest


@pytest.mark.parametrize("name", SOLIDS)
def test_a_ball_on_a_solid_touches_where_the_object_is(name: str) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform((-9, -9, -1), (9, 9, 3), (4000, 3))
    distance = OBJECTS[name]().sdf(points)
    near = np.abs(distance) < 0.15
    assert near.sum() > 20
    off = np.abs(_to_solid_mm(name, points[near]) - ROUNDING_MM - distance[near])
    assert np.percentile(off, 90) < 1e-6
    assert off.max() < 0.09  # upright edges, where two outlines meet


def test_before_the_drag_an_object_was_where_its_press_says() -> None:
    rng = np.random.default_rng(2)
    for way in ways(DOME, 5, 8):
        press, before = way.press, way.pressed(DOME.radius_mm)
        points = rng.uniform((-8, -8, 12), (8, 8, 22), (500, 3))
        back = np.column_stack((press.before_drag(points[:, :2]), points[:, 2]))
        np.testing.assert_allclose(
            before.distance_mm(DOME.radius_mm, back), press.distance_mm(DOME.radius_mm, points), atol=1e-5
        )


def test_a_tilted_plate_is_pressed_in_along_its_normal() -> None:
    depth = plate_depth_mm(2.0, DOME.radius_mm, 1.0, 12.0, -9.0)
    plate = Press(OBJECTS["plate"](), depth_mm=depth, tilt_x_deg=12.0, tilt_y_deg=-9.0)
    skin = DOME.radius_mm * cap(DOME.radius_mm, 0.5)[0]
    assert plate.distance_mm(DOME.radius_mm, skin).min() == pytest.approx(-2.0, abs=0.1)


@pytest.mark.slow
def test_a_skin_through_moved_points_has_their_height_and_shear() -> None:
    rest = DOME.radius_mm * cap(DOME.radius_mm, 1.0)[0]
    near = np.exp(-(rest[:, 0] ** 2 + rest[:, 1] ** 2) / 30) * (rest[:, 2] > 0)
    moved = np.array((0.9, -0.4, -1.5)) * near[:, None]
    model = replace(drawn("working", 0)[0], skin_radius_mm=DOME.radius_mm)
    skin = deformed(DOME.radius_mm, rest, rest + moved)
    at = model.geometry.disc
    points = skin_points(skin, model.geometry, np.array([at.row_c]), np.array([at.col_c]))
    # The material on the axis was at rest - (0.9, -0.4, ..) * near; found by iterating its definition.
    before = np.zeros(2)
    for _ in range(50):
        before = -np.array((0.9, -0.4)) * np.exp(-(before @ before) / 30)
    np.testing.assert_allclose(shear_mm(skin, points, model.friction)[0], -before, atol=0.02)
    height = np.sqrt(DOME.radius_mm**2 - before @ before) - 1.5 * np.exp(-(before @ before) / 30)
    assert np.linalg.norm(points[0]) == pytest.approx(height, abs=0.01)


@pytest.mark.slow
def test_pins_go_with_the_skin() -> None:
    model, dome = drawn("working", 1)
    rest = dome.radius_mm * cap(dome.radius_mm, 1.5)[0]
    near = np.exp(-(rest[:, 0] ** 2 + rest[:, 1] ** 2) / 60)[:, None] * (rest[:, 2:] > 0)
    draws = renderer(replace(model, surround="dark"), 1)
    still, there = (
        draws.draw(deformed(dome.radius_mm, rest, rest + near * np.array((by_mm, 0, 0)))) for by_mm in (0.0, 2.0)
    )
    by_px = 2.0 * model.geometry.f_px / (dome.radius_mm + model.geometry.camera_distance_mm)
    row, col, half = round(model.row_c), round(model.col_c), 15

    def around(image: np.ndarray, shift_px: int) -> np.ndarray:
        cut = image[row - half : row + half, col - half + shift_px : col + half + shift_px]
        return cut - cut.mean()

    likeness = [float((around(still, 0) * around(there, by)).sum()) for by in range(-5, round(by_px) + 6)]
    assert abs(int(np.argmax(likeness)) - 5 - by_px) <= 2


def test_missing_states_are_said_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate.main(["--states", str(tmp_path), "--sensors", "1", "--ways", "1"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "working-0-0.npz is missing" in said


@pytest.mark.slow
def test_the_engine_presses_and_drags_a_dome() -> None:
    pytest.importorskip("mujoco", reason="the engine is not installed: tools/studies/third_family/requirements.txt")
    from tools.studies.third_family.solve import solved

    (way, *_) = (each for each in ways(DOME, 5, 7) if each.object_name == "ball")
    way = replace(
        way, press=replace(way.press, x_mm=1.5, y_mm=0.0, depth_mm=2.0, drag_x_mm=1.5, drag_y_mm=0.0, twist_deg=0.0)
    )
    rest, pressed, dragged = solved(DOME, way, edge_mm=2.5, gel_layers=2)
    height = DOME.radius_mm - np.linalg.norm(pressed.at_mm, axis=1)
    depth = way.pressed(DOME.radius_mm).depth_mm
    assert height.max() == pytest.approx(depth, abs=0.3)
    assert max(pressed.penetration_mm, dragged.penetration_mm) < 0.15
    rim = rest[:, 2] < rest[:, 2].min() + 1e-6
    np.testing.assert_allclose(pressed.at_mm[rim], rest[rim], atol=1e-9)
    touching = way.press.distance_mm(DOME.radius_mm, dragged.at_mm) < 0.1
    went = (dragged.at_mm - pressed.at_mm)[touching]
    assert 0.3 < went[:, 0].mean() < 1.6
    assert abs(went[:, 1].mean()) < 0.3
    # The gel keeps its volume: what the ball pushes in comes out beside it.
    assert height.min() < -0.005
    truth = seen_truth(deformed(DOME.radius_mm, rest, dragged.at_mm), (way.press,), drawn("working", 0)[0])
    assert truth.depth_max_mm > 1.0
