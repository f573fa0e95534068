from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tacshade_edge.rigid import Rigid
from tacshade_edge.simulator.hand.bodies import cylinder
from tacshade_edge.simulator.hand.held import Placement
from tacshade_edge.simulator.hand.script import HandScript
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.simulator.scene import SimulatedSensor
from tools.testbed.simulator.held_hand import DrawnSensor, HandFrame, about, hand_frames, looking_at
from tools.testbed.simulator.other_family import OtherSensor, other_model

pytestmark = pytest.mark.slow
HOME = Rigid(np.eye(3), np.zeros(3))
CAN = cylinder(30.0, 100.0)


def of_family(make: Callable[[], DrawnSensor], fps: float = 5) -> list[HandFrame]:
    sensors = [make(), make()]
    model = sensors[0].model
    sides = [np.array((0.0, 0.0, s)) for s in (30.0, -30.0)]
    places = [looking_at(at, -at, 1.5, model.skin_radius_mm) for at in sides]
    away = about(HOME, np.array((0.0, 1.0, 0.0)), np.zeros(3))
    script = HandScript((0.0,), (Placement(HOME),)).held(0.4).moved(away, 0.4).held(0.4)
    return list(hand_frames(sensors, places, CAN, script, fps, seed=4))


@pytest.mark.parametrize(
    "make",
    [
        lambda: SimulatedSensor(SensorModel()),
        lambda: OtherSensor(other_model(2)),
        lambda: SimulatedSensor(random_model(5)),
    ],
    ids=["default", "other", "random"],
)
def test_two_fingers_see_an_object_go(make: Callable[[], DrawnSensor]) -> None:
    frames = of_family(make)
    assert [frame.t_s for frame in frames] == pytest.approx(np.arange(7) / 5)
    assert [frame.truth.fingers[0].name for frame in frames[:1]] == ["thumb"]
    moved = [float(frame.truth.motion.translation_mm[1]) for frame in frames]
    assert moved == pytest.approx([0, 0, 0, 0.5, 1, 1, 1])
    depths = [finger.depth_mm for finger in frames[0].truth.fingers]
    assert depths == pytest.approx([1.5, 1.5], abs=0.05)
    for k, finger in enumerate(frames[-1].truth.fingers):
        assert finger.press is not None
        assert abs(finger.press.drag_y_mm) == pytest.approx(1.0, abs=1e-3)
        rests, dragged = (frame.images[k].astype(int) for frame in (frames[0], frames[-1]))
        assert np.abs(rests - dragged).mean() > 1.0, "its picture changes"
    assert frames[0].skins[0] is frames[1].skins[0]
    assert (frames[0].images[0] != frames[1].images[0]).any(), "the noise goes on"


def test_the_same_seed_gives_the_same_frames() -> None:
    one, other = (of_family(lambda: SimulatedSensor(random_model(5))) for _ in range(2))
    assert all((a.images[1] == b.images[1]).all() for a, b in zip(one, other, strict=True))
