import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.lab.simulator.drag import drag_skin
from tacshade_edge.lab.simulator.leaning import leant_mm
from tacshade_edge.lab.simulator.membrane import slid, solve
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball
from tacshade_edge.lab.simulator.render import carried
from tacshade_edge.lab.simulator.sensor_model import RIM_HALF_ANGLE_DEG, SensorModel
from tacshade_edge.lab.simulator.skin import Skin, chart_to_direction, press_skin
from tacshade_edge.lab.simulator.truth import SimulatedSensor, shear_mm
from tacshade_edge.types import F32, F64

pytestmark = pytest.mark.slow

STICKY = SensorModel(coulomb=50.0, sway=0.0)


def dragged(model: SensorModel, *presses: Press) -> Skin:
    def shape(leaning_mm: F32 | None) -> Skin:
        return press_skin(model.skin_radius_mm, model.skin_decay_mm, presses, leaning_mm)

    return drag_skin(shape, model, presses)


def surface(skin: Skin, x_mm: F64, y_mm: F64) -> F64:
    """Points (N, 3) of the skin at chart coordinates."""
    return (
        chart_to_direction(x_mm, y_mm, skin.radius_mm)
        * (skin.radius_mm - skin.sample(x_mm, y_mm))[:, None]
    )


def flat_problem(radius: float, depth: float, size: int = 141) -> F32:
    """A ball over the middle of a plane, in steps of the grid; below 0 beside it."""
    axis = np.arange(size, dtype=np.float32) - size // 2
    return np.asarray(depth - (axis[:, None] ** 2 + axis[None, :] ** 2) / (2 * radius), np.float32)


def pull(h: F32, mass: float) -> F32:
    """(4 + m) h less the sum of the neighbours; 0 on the border."""
    result = np.zeros_like(h)
    result[1:-1, 1:-1] = (4 + mass) * h[1:-1, 1:-1] - (
        h[:-2, 1:-1] + h[2:, 1:-1] + h[1:-1, :-2] + h[1:-1, 2:]
    )
    return result


@pytest.mark.parametrize("friction", [0.5, 1.0, 2.0])
def test_the_traction_is_the_difference_of_two_pressures(friction: float) -> None:
    # Ciavarella's and Jäger's theorem: what a ball drags by `shift` is `friction` times what is
    # between its indentation and one that is less deep by shift / friction.
    obstacle, mass, shift = flat_problem(80.0, 4.0), np.full((141, 141), 0.05, np.float32), 1.5
    deep = solve(np.maximum(obstacle, 0), mass)
    shallow = solve(np.maximum(obstacle - shift / friction, 0), mass)
    limit = np.where(
        deep <= np.maximum(obstacle, 0) + 1e-4, friction * np.maximum(pull(deep, 0.05), 0), 0
    )
    limit[obstacle <= 0] = 0
    held = np.zeros((2, 141, 141), np.float32)
    held[0][limit > 0] = shift
    w = slid(held, limit.astype(np.float32), mass)
    assert np.abs(w[0] - friction * (deep - shallow)).max() < 0.02
    assert np.abs(w[1]).max() < 1e-6


@pytest.mark.parametrize("name", ["ball", "cube", "ring"])
def test_skin_that_sticks_goes_with_the_object(name: str) -> None:
    press = Press(
        OBJECTS[name](), 2.0, -1.0, 3.0, 20.0, drag_x_mm=1.2, drag_y_mm=-0.8, twist_deg=5.0
    )
    frame = SimulatedSensor(STICKY).frame((press,))
    truth = frame.truth()
    rows, cols = np.nonzero(truth.contact)
    moved = frame.shear_mm(rows.astype(float), cols.astype(float))
    here = truth.points_mm[:, :2].astype(float)
    upright = SimulatedSensor(STICKY).frame(
        (replace(press, drag_x_mm=0.0, drag_y_mm=0.0, twist_deg=0.0),)
    )
    pressed = upright.shear_mm(rows.astype(float), cols.astype(float))
    off = np.linalg.norm(moved - pressed - (here - press.before_drag(here)), axis=1)
    assert frame.skin.stuck[0] > 0.9
    assert np.median(off) < 0.03
    assert np.quantile(off, 0.95) < 0.25  # of the outermost cells of the contact


def test_more_drag_sticks_less_and_what_is_not_dragged_is_as_it_was() -> None:
    stuck = [
        dragged(SensorModel(), Press(ball(), 1.0, 0.0, 3.0, drag_x_mm=d)).stuck[0]
        for d in (0.5, 1.5, 3.0, 6.0)
    ]
    assert stuck == sorted(stuck, reverse=True)
    assert stuck[0] > 0.7
    assert stuck[-1] == 0.0
    press = Press(ball(), 1.0, 0.0, 3.0)
    assert dragged(SensorModel(), press).origin_mm is None


def test_a_dome_that_sways_leans_everywhere_but_at_the_rim() -> None:
    model = SensorModel(coulomb=50.0, sway=0.5)
    skin = dragged(model, Press(ball(4.0), 0.0, 0.0, 3.0, drag_x_mm=3.0))
    assert skin.leaning_mm is not None
    far = surface(skin, np.array([-11.0]), np.array([3.0]))  # beyond the local shear's decay
    assert shear_mm(skin, far, model.friction)[0, 0] == pytest.approx(
        1.5 * (np.cos(0.57) - np.cos(1.257)) / 0.69, abs=0.2
    )
    assert skin.leaning_mm.min() < -0.2 < 0.2 < skin.leaning_mm.max()
    rim = math.radians(RIM_HALF_ANGLE_DEG)
    clamped = np.array([[math.sin(rim), 0.0, math.cos(rim)]])
    assert np.abs(leant_mm(clamped, np.array([2.0, 1.0]))).max() < 1e-12
    frame = SimulatedSensor(model).frame((Press(ball(4.0), 0.0, 0.0, 3.0, drag_x_mm=3.0),))
    height = frame.truth().height_mm
    assert np.nanmin(height) == 0.0  # what moves outwards has no depth


def test_a_dome_full_of_gel_keeps_its_volume() -> None:
    model = SensorModel(bulge=1.0)
    skin = dragged(model, Press(OBJECTS["plate"](), 0.0, 0.0, 4.0))
    axis = np.linspace(0, math.radians(RIM_HALF_ANGLE_DEG), 400)
    chart = 2 * model.skin_radius_mm * np.tan(axis / 2)
    assert skin.leaning_mm is not None
    out = -(skin.sample(chart, 0 * chart) - skin.sample_pressed(chart, 0 * chart))
    volume = (
        2
        * math.pi
        * model.skin_radius_mm**2
        * float(np.sum(out * np.sin(axis)))
        * (axis[1] - axis[0])
    )
    cap = math.pi * 4.0**2 * (3 * model.skin_radius_mm - 4.0) / 3
    assert volume == pytest.approx(
        cap, rel=0.25
    )  # h counts along the radius, which a cap of 4 mm is small for
    assert out.min() > -1e-6
    assert out.max() > 0.5
    assert max(abs(out[0]), abs(out[-1])) < 1e-4
    assert (
        dragged(replace(model, bulge=0.0), Press(OBJECTS["plate"](), 0.0, 0.0, 4.0)).leaning_mm
        is None
    )


def test_what_is_drawn_is_what_is_true() -> None:
    # Material carried forward by the renderer is, by the truth, displaced by as much.
    skin = dragged(
        SensorModel(), Press(OBJECTS["cube"](), 2.0, 1.0, 3.0, 20.0, drag_x_mm=2.0, twist_deg=8.0)
    )
    rng = np.random.default_rng(3)
    chart = rng.uniform(-11, 11, (500, 2))
    direction, now = carried(skin, chart, 0.9)
    points = direction * (skin.radius_mm - skin.sample(now[:, 0], now[:, 1]))[:, None]
    before = skin.radius_mm * chart_to_direction(chart[:, 0], chart[:, 1], skin.radius_mm)
    off = np.linalg.norm(shear_mm(skin, points, 0.9) - (points - before)[:, :2], axis=1)
    assert np.quantile(off, 0.99) < 0.02


@settings(deadline=None, max_examples=15)
@given(
    name=st.sampled_from(sorted(OBJECTS)),
    x_mm=st.floats(-9, 9),
    depth_mm=st.floats(0.1, 6.0),
    drag_x_mm=st.floats(-8, 8),
    drag_y_mm=st.floats(-8, 8),
    twist_deg=st.floats(-40, 40),
    coulomb=st.floats(0, 20),
    sway=st.floats(0, 0.9),
    decay_mm=st.floats(1.0, 15.0),
)
def test_no_drag_folds_the_skin_or_moves_it_further_than_the_object(
    name: str,
    x_mm: float,
    depth_mm: float,
    drag_x_mm: float,
    drag_y_mm: float,
    twist_deg: float,
    coulomb: float,
    sway: float,
    decay_mm: float,
) -> None:
    model = SensorModel(coulomb=coulomb, sway=sway, drag_decay_mm=decay_mm)
    press = Press(
        OBJECTS[name](),
        x_mm,
        1.0,
        depth_mm,
        drag_x_mm=drag_x_mm,
        drag_y_mm=drag_y_mm,
        twist_deg=twist_deg,
    )
    skin = dragged(model, press)
    assert np.isfinite(skin.height_mm).all()
    if skin.origin_mm is None:
        return
    assert np.isfinite(skin.origin_mm).all()
    n = len(skin.origin_mm) // 2
    axis = np.arange(-n, n + 1) * skin.step_mm
    x, y = (v + skin.origin_mm[..., k] for k, v in enumerate(np.meshgrid(axis, axis)))
    area = np.gradient(x, skin.step_mm, axis=1) * np.gradient(y, skin.step_mm, axis=0)
    area -= np.gradient(x, skin.step_mm, axis=0) * np.gradient(y, skin.step_mm, axis=1)
    assert area.min() > 0.2
    # The chart is up to a fifth larger than the skin;
    # a turn moves what is far from its middle further.
    most = math.hypot(drag_x_mm, drag_y_mm) + abs(math.radians(twist_deg)) * 26
    assert np.linalg.norm(skin.origin_mm, axis=-1).max() <= 1.6 * most + 1e-3
