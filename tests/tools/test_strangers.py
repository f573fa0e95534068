"""Families of sensors that training never sees: their mechanics, cameras, prints and truth."""

from __future__ import annotations

import json
import math
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball
from tacshade_edge.lab.simulator.render import project
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.types import F64
from tools.studies.strangers import evaluate, grid, lattices, layered, oblate, solve
from tools.studies.strangers.camera import Camera
from tools.studies.strangers.evaluate import Case, Judged, lines
from tools.studies.strangers.families import FAMILIES
from tools.studies.strangers.hexahedra import Layer, Mesh, meshed, stiffness
from tools.studies.strangers.layered_solver import LayeredSolver, compliance
from tools.studies.strangers.motion import Pose, clearance_mm, moves
from tools.studies.strangers.oblate_solver import OblateSolver
from tools.studies.strangers.paths import STOPS, Dome, States, paths, states_file
from tools.studies.strangers.sensor import Stranger, calibrated
from tools.studies.strangers.shell import Shell, ShellMaterial
from tools.studies.strangers.solved import Solved, untouched
from tools.studies.strangers.surface import Surface, seen, truth

needs_numba = pytest.mark.skipif(
    find_spec("numba") is None, reason="numba (the extra fit) is not installed"
)
BALL = Press(ball(5.0), x_mm=2.0, y_mm=-1.0, depth_mm=1.0)


def sphere(direction: F64) -> F64:
    return np.full(direction.shape[:-1], 20.0)


def small_mesh(
    layers: tuple[Layer, ...] = (Layer(2.0, 1, 4.0, 0.49), Layer(8.0, 2, 1.0, 0.49)),
) -> Mesh:
    return meshed(20.0, layers, square=3, rings=3)


# -- cameras


def test_a_fisheye_lens_maps_angles_in_proportion() -> None:
    camera = Camera("fisheye", 10.0, 200.0, 240.0, 320.0)
    angles = np.radians((5.0, 10.0, 20.0, 40.0))
    points = np.stack((np.sin(angles), 0 * angles, np.cos(angles)), axis=1) * 7.0 - (0, 0, 10)
    at = camera.project(points)
    np.testing.assert_allclose(at[:, 0] - 320, 200 * angles)
    np.testing.assert_allclose(at[:, 1], 240)


def test_an_upright_pinhole_is_the_simulators_and_a_tilt_moves_the_tip() -> None:
    model = SensorModel()
    geometry = model.geometry
    camera = Camera("pinhole", 14.0, geometry.f_px, model.row_c, model.col_c)
    points = np.array(((0.0, 0, 20), (5, -3, 18), (-8, 2, 16)))
    np.testing.assert_allclose(camera.project(points), project(geometry, points))
    tilted = Camera("pinhole", 14.0, geometry.f_px, model.row_c, model.col_c, tilt_y_deg=3.0)
    moved = tilted.project(points[0]) - camera.project(points[0])
    assert moved[0] == pytest.approx(geometry.f_px * math.tan(math.radians(3)))
    assert moved[1] == pytest.approx(0, abs=1e-9)


# -- grids, layers, paths


def test_a_grid_covers_the_dome_without_folds() -> None:
    direction, quads = grid.directions(4, 5, rim_deg=60.0)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1)
    at_rim = np.degrees(np.arccos(direction[-32:, 2]))
    np.testing.assert_allclose(at_rim, 60)
    flat = direction[quads][..., :2]
    one, other = flat[:, 2] - flat[:, 0], flat[:, 3] - flat[:, 1]
    turns = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    assert np.all(turns > 0) or np.all(turns < 0)


def test_rigid_motions_of_layers_need_no_force_and_a_stretch_stores_its_energy() -> None:
    mesh = small_mesh((Layer(3.0, 1, 2.0, 0.3),))
    matrix, points = stiffness(mesh), mesh.points_mm
    turn = np.cross(points, (0.1, -0.2, 0.3))
    assert np.abs(matrix @ (turn + 1.0).ravel()).max() < 1e-9
    strain = np.diag((0.01, -0.004, 0.002))
    moved = (points @ strain).ravel()
    lame, shear = 2 * 0.3 / (1.3 * 0.4), 2 / (2 * 1.3)
    density = lame * np.trace(strain) ** 2 / 2 + shear * np.sum(strain**2)
    volume_mm3 = _volume_mm3(mesh)
    assert moved @ (matrix @ moved) / 2 == pytest.approx(density * volume_mm3, rel=1e-9)


def _volume_mm3(mesh: Mesh) -> float:
    from tools.studies.strangers.hexahedra import _gradients

    return float(_gradients(mesh.points_mm[mesh.corners])[1].sum())


def test_a_folded_hexahedron_is_refused() -> None:
    mesh = small_mesh()
    mesh.points_mm[mesh.corners[0]] *= -1
    with pytest.raises(ValueError, match="folded"):
        stiffness(mesh)


@pytest.mark.parametrize("kind", STOPS)
def test_paths_reach_stated_depths_below_the_skin(kind: str) -> None:
    skin = oblate.drawn("working", 0)
    dome = Dome(skin.radius_mm, skin.surface_z, 3.0)
    made = paths(dome, kind, 7, 10)
    assert [path.object_name for path in made] == [
        path.object_name for path in paths(dome, kind, 7, 12)[:10]
    ]
    for path in made:
        first = path.stops[0]
        lowest = first.lowest_z_mm(skin.radius_mm)
        assert skin.surface_z(first.x_mm, first.y_mm) - lowest == pytest.approx(path.depths_mm[0])
        for stop in path.stops[1:]:
            assert stop.lowest_z_mm(skin.radius_mm) == pytest.approx(lowest)
            assert math.hypot(stop.drag_x_mm, stop.drag_y_mm) == pytest.approx(
                2.0 * skin.radius_mm / 20
            )


def test_an_object_comes_from_above_and_ends_at_its_stop() -> None:
    rest = grid.directions(4, 4)[0] * 20.0
    lifted = clearance_mm(rest, 20.0, BALL)
    assert 0.7 < lifted < 1.05
    ((poses),) = list(moves(20.0, (BALL,), lifted, 0.3))
    assert poses[0][0].distance_mm(rest).min() > -0.3
    np.testing.assert_allclose(poses[-1][0].distance_mm(rest), BALL.distance_mm(20.0, rest))
    normals = poses[-1][0].normals(rest[:3])
    centre = np.array((2.0, -1.0, BALL.lowest_z_mm(20.0) + 5.0))
    away = rest[:3] - centre
    np.testing.assert_allclose(
        normals, away / np.linalg.norm(away, axis=1, keepdims=True), atol=1e-4
    )


# -- mechanics


@needs_numba
@pytest.mark.slow
def test_forces_of_contact_push_within_the_friction_and_nothing_lies_inside() -> None:
    from tools.studies.strangers import contact

    mesh = small_mesh()
    touchable = np.flatnonzero(mesh.points_mm[: mesh.surface, 2] > 15)
    degrees = (3 * touchable[:, None] + np.arange(3)).ravel()
    soft = compliance(mesh, touchable)[degrees]
    rest = mesh.points_mm[touchable]
    dragged = Press(ball(5.0), 3.5, -1.0, BALL.depth_mm, drag_x_mm=1.5)
    for press, forces in zip(
        (BALL, dragged), contact.solved(rest, soft, 0.4, 20.0, (BALL, dragged)), strict=True
    ):
        at = rest + (soft @ forces.ravel()).reshape(-1, 3)
        pose = Pose(press, 20.0, np.array((press.x_mm, press.y_mm, press.origin_z_mm(20.0))))
        assert pose.distance_mm(at).min() > -0.01
        pushed = np.linalg.norm(forces, axis=1) > 0
        assert pushed.any()
        normal = pose.normals(at[pushed])
        across = np.sum(forces[pushed] * normal, axis=1)
        along = np.linalg.norm(forces[pushed] - across[:, None] * normal, axis=1)
        assert np.all(across > 0)
        assert np.all(along <= 0.4 * across * 1.05)
    dragged_force = forces.sum(axis=0)
    assert dragged_force[0] > 0.1 * abs(dragged_force[2])  # the object pulls the skin along


@pytest.fixture(scope="module")
def shell() -> Shell:
    direction, quads = grid.directions(4, 4, rim_deg=60.0)
    triangles = np.concatenate((quads[:, (0, 1, 2)], quads[:, (0, 2, 3)]))
    clamped = np.arange(len(direction) - 32, len(direction))
    return Shell(direction * 20.0, triangles, clamped, ShellMaterial(1.0, 0.05, 0.4, 0.6))


def test_a_shells_newton_step_follows_its_energy(shell: Shell) -> None:
    rng = np.random.default_rng(3)
    at = shell.rest_mm + rng.normal(0, 0.05, shell.rest_mm.shape)
    pose = Pose(BALL, 20.0, np.array((2.0, -1.0, BALL.origin_z_mm(20.0) - 0.3)))
    touch = shell._touch(at, at - 0.01, pose, np.array((0.05, 0, 0)))
    assert len(touch.inside)
    gradient, _ = touch.derivatives(at)
    change, tiny = rng.normal(0, 1, at.shape), 1e-6
    slope = (touch.energy(at + tiny * change) - touch.energy(at - tiny * change)) / (2 * tiny)
    assert np.sum(gradient * change) == pytest.approx(slope, rel=1e-4)
    membrane = shell._membrane(at, stiffness=True)
    slope = (
        shell._membrane(at + tiny * change, stiffness=False)[0]
        - shell._membrane(at - tiny * change, stiffness=False)[0]
    ) / (2 * tiny)
    assert membrane[1] @ change.ravel() == pytest.approx(slope, rel=1e-5)
    energy, step = shell._newton(at, touch)
    assert shell._energy(at + 0.1 * step, touch) < energy


@pytest.mark.slow
def test_a_pressed_shell_yields_to_the_object_and_keeps_its_volume(shell: Shell) -> None:
    (at,) = shell.solved(20.0, (BALL,))
    assert BALL.distance_mm(20.0, at).min() > -0.1
    inwards = 20 - np.linalg.norm(at, axis=1)
    assert 0.7 < inwards.max() < 1.3
    assert inwards.min() < -0.02  # the gel bulges elsewhere
    assert shell._volume(at)[0] == pytest.approx(shell._volume_mm3, rel=1e-3)
    np.testing.assert_array_equal(at[-32:], shell.rest_mm[-32:])


# -- skins at rest, surfaces and truth


def test_an_oblate_skin_passes_through_the_tip_and_the_rim_and_is_flatter_between() -> None:
    skin = oblate.drawn("working", 1)
    theta = math.radians(skin.half_angle_deg)
    angle = np.array((0.0, theta))
    direction = np.stack((np.sin(angle), 0 * angle, np.cos(angle)), axis=1)
    np.testing.assert_allclose(skin.rest_mm(direction), skin.radius_mm)
    half = np.array((math.sin(theta / 2), 0.0, math.cos(theta / 2)))
    assert 0.03 < float(skin.rest_mm(half)) - skin.radius_mm < 1.0
    point = half * skin.rest_mm(half)
    assert skin.surface_z(point[0], point[1]) == pytest.approx(point[2])


@pytest.mark.slow
def test_truth_is_the_motion_inwards_of_the_skin_that_a_pixel_sees() -> None:
    camera = Camera("fisheye", 10.0, 350.0, 240.0, 320.0)
    rest = grid.directions(8, 8)[0] * 20.0
    dent = np.exp(-(rest[:, 0] ** 2 + rest[:, 1] ** 2) / 40)
    surface = Surface(rest, rest * (1 - dent[:, None] / 20), sphere)
    view = seen(surface, camera, 45.0, 20.0)
    inside = np.hypot(*(np.mgrid[:480, :640] - np.array((240, 320))[:, None, None])) < 150
    found = truth(view, inside, Press(OBJECTS["plate"](), depth_mm=1.0), 20.0, sphere)
    assert found.height_mm is not None
    assert found.contact is not None
    assert found.depth_max_mm == pytest.approx(1.0, abs=0.01)
    np.testing.assert_allclose(found.height_mm[240, 320], 1.0, atol=0.01)
    assert found.contact[240, 320]
    assert not found.contact[240, 420]
    np.testing.assert_allclose(found.points_mm[:, 2], 19.0, atol=0.07)
    flat = truth(seen(untouched(sphere), camera, 45.0, 20.0), inside, None, 20.0, sphere)
    assert flat.depth_max_mm < 3e-3
    assert len(flat.points_mm) == 0


def test_lattices_have_their_pitch() -> None:
    far, pitch = lattices.reach(45.0), 0.1
    corners, middles = lattices.hexagonal(pitch, far, 0.3)
    places = [corners, lattices.spiral(pitch, far, 0.3), *lattices.rings(pitch, far, 0.3)]
    for chart in places:
        near = [np.sort(np.linalg.norm(chart - at, axis=1))[1] for at in chart[:40]]
        assert 0.5 * pitch < np.median(near) < 1.3 * pitch
    assert len(middles) == 2 * len(corners)


# -- sensors


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.slow
def test_every_family_gives_references_that_calibrate(name: str, tmp_path: Path) -> None:
    sensor: Stranger = FAMILIES[name]("working", 1, tmp_path)
    references = sensor.references(2)
    assert references[0].shape == (480, 640, 3)
    assert np.any(references[0] != references[1])
    np.testing.assert_array_equal(references[0], sensor.references(1)[0])
    found = calibrated(sensor).calibration.geometry
    assert found.skin_radius_mm == sensor.stated.skin_radius_mm
    with pytest.raises(FileNotFoundError):
        next(iter(sensor.judged()))


@pytest.mark.parametrize("make", [layered.layered, oblate.oblate])
def test_ranges_draw_other_sensors(make: solve.Maker, tmp_path: Path) -> None:
    one, other = make("working", 0, tmp_path), make("final", 0, tmp_path)
    assert one.seed != other.seed
    assert one.stated != other.stated
    assert one.stated == make("working", 0, tmp_path).stated


def stored(sensor: Solved, solver: solve.Solver) -> None:
    for kind in STOPS:
        file, stops = solve.missing(sensor, kind)[0]
        solver.solved(stops).write(file)


@pytest.mark.slow
def test_a_solved_sensor_gives_touches_presses_and_truth(tmp_path: Path) -> None:
    sensor = oblate.oblate("working", 0, tmp_path)
    stored(sensor, OblateSolver(oblate.drawn("working", 0), square=4, rings=4))
    before = sensor.references(1)[0].astype(float)
    (touch,) = sensor.touches(1)
    assert np.abs(touch - before).max() > 50
    (press,) = sensor.balls(1)
    assert isinstance(press, KnownPress)
    assert 2.5 < press.radius_mm < 8
    assert press.depth_mm > 0.4
    scenes = sensor.judged()
    pressed, dragged = next(scenes), next(scenes)
    assert (pressed.dragged, dragged.dragged) == (False, True)
    assert pressed.object_name == dragged.object_name == "cube"
    assert 1.5 < pressed.truth.depth_max_mm < 4
    apart = pressed.truth.points_mm.mean(axis=0) - dragged.truth.points_mm.mean(axis=0)
    assert 1.0 < np.linalg.norm(apart[:2]) < 3.0


@needs_numba
@pytest.mark.slow
def test_a_layered_skin_yields_and_dents_far_around(tmp_path: Path) -> None:
    skin = layered.drawn("working", 0)
    layers = (Layer(skin.skin_mm, 1, skin.stiffness_ratio, 0.49), Layer(8.0, 2, 1.0, 0.49))
    solver = LayeredSolver(skin, meshed(skin.radius_mm, layers, square=4, rings=4))
    states = solver.solved((BALL,))
    file = states_file(tmp_path, "working", 0, "ball", 0)
    states.write(file)
    kept = States.read(file)
    np.testing.assert_allclose(kept.stops_mm, states.stops_mm, atol=1e-5)
    inwards = skin.radius_mm - np.linalg.norm(kept.stops_mm[0], axis=1)
    assert 0.6 < inwards.max() < 1.4


# -- the study


def judged(me_mm: float, dragged: bool = False) -> Judged:
    return Judged("accurate", "cube", dragged, me_mm, 90.0)


def test_a_table_compares_each_sensor_with_itself_as_shipped() -> None:
    results = {
        Case("third", "working", number, way): [judged(me_mm), judged(math.nan), judged(1.0, True)]
        for way, both in (("shipped", (0.4, 0.2)), ("none", (0.2, 0.25)))
        for number, me_mm in enumerate(both)
    }
    (line,) = (
        cells for cells in lines("third", ("none",), results) if cells[1:3] == ["none", "accurate"]
    )
    assert line[3:8] == ["0.225", "0.75", "1.25", "2 of 4", "90"]
    assert line[8:13] == ["1.000", "1.00", "1.00", "0 of 2", "90"]


@pytest.mark.slow
def test_a_kept_case_is_not_measured_again_unless_the_program_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case("third", "working", 0, "shipped")
    known = {"program": evaluate.fingerprint([evaluate.PROGRAM]), "rows": [], "fit_s": 1.0}
    case.file(tmp_path).write_text(json.dumps(known))
    assert list(evaluate.of_cases([case], tmp_path / "none", tmp_path)) == [(case, known)]
    monkeypatch.setattr(evaluate, "fingerprint", lambda _: "another")
    with pytest.raises(FileNotFoundError):  # it is measured, and nothing was solved
        list(evaluate.of_cases([case], tmp_path / "none", tmp_path))


def test_a_sensor_whose_presses_are_refused_is_calibrated_without_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = layered.layered("working", 0, tmp_path)
    untouched_press = KnownPress("press 0", own.references(1)[0], 5.0, 2.0, x_mm=0.0, y_mm=0.0)
    stranger = SimpleNamespace(
        stated=own.stated,
        references=own.references,
        balls=lambda: [untouched_press] * 8,
        judged=lambda: iter(()),
    )
    monkeypatch.setitem(evaluate.FAMILIES, "layered", lambda *_: stranger)
    found = evaluate.measured(tmp_path, Case("layered", "working", 0, "balls"))
    assert found["kept"] == found["rows"] == []
    assert "8 of 8 presses are unusable" in found["said"][0]


def test_a_wrong_family_or_way_is_refused_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for option, wrong in (("--families", "fourth"), ("--ways", "guesses")):
        with pytest.raises(SystemExit):
            evaluate.main(["--states", str(tmp_path), option, wrong])
        assert f"found '{wrong}', expected one of" in capsys.readouterr().err


@pytest.mark.slow
def test_states_that_are_missing_are_named_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--states", str(tmp_path), "--families", "layered", "--sensors", "1", "--ways", ""]
    assert evaluate.main(options) == 1
    missing = tmp_path / "layered" / "working-0-judged-0.npz"
    assert capsys.readouterr().err == (
        f"{missing} is missing: solve the family first (README.md)\n"
    )
