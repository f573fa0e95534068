"""The examples with a sensor in MuJoCo: a surface and an edge followed."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tacshade_edge as ts
from support.felt_objects import written
from support.mqtt_rig import Broker, free_port
from support.patience import patience, wait_until
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tools.examples.servo.follow_surface import FollowSurface

pytest.importorskip("mujoco")
pytestmark = pytest.mark.slow
FRAME_S = 1 / 30


@pytest.fixture(scope="module")
def sensor_xml(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("mjcf"), SensorModel())


def test_the_loop_follows_the_hill_at_its_depth_and_at_right_angles(sensor_xml: Path) -> None:
    from tools.examples.mujoco.serve import above_a_hill, depth_mm

    hand, follow = above_a_hill(str(sensor_xml)), FollowSurface(1.5, 10.0)
    for _ in range(60):
        touch: Any = hand.sensor.read(shear=False).touch
        hand.move(np.array(follow.velocity(touch, FRAME_S)), FRAME_S)
    end: Any = hand.sensor.read(shear=False).touch
    assert hand.tip.translation_mm[0] > 18
    assert abs(depth_mm(hand) - 1.5) < 0.15
    assert abs(end["tilt_y_deg"]) < 1


def test_the_disc_is_followed_along_its_edge(sensor_xml: Path) -> None:
    from tools.examples.mujoco.follow_edge import FollowEdge, velocity

    world = FollowEdge(str(sensor_xml))
    felt, _ = world.reset(seed=3)
    assert felt.shape == (3,)
    for _ in range(75):
        felt, reward, lost, late, _ = world.step(velocity(felt))
        assert (lost, late) == (False, False)
        assert -1.5 < reward <= 0
    # A quarter of a radian at least, so it has turned with the edge.
    assert abs(felt[2]) < 12
    assert world.step(np.array((0.0, 0.0, -100.0, 0.0)))[2]


def along_mm(results: ts.Results) -> float:
    """How far along x the sensor is in the next result; negative if none comes."""
    try:
        pose = next(results).pose
    except ts.DeviceError:
        return -1.0
    return -1.0 if pose is None else pose.x_mm


@pytest.fixture
def children_heed_ctrl_c() -> Iterator[None]:
    """Whatever a shell that started the tests in the background ignores, and its children too."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.broker
@pytest.mark.usefixtures("children_heed_ctrl_c")
def test_the_program_for_a_board_follows_the_simulated_surface(
    sensor_xml: Path, tmp_path: Path
) -> None:
    python, port = [sys.executable, "-m"], str(free_port())
    with Broker(tmp_path) as broker:
        address = f"127.0.0.1:{broker.port}"
        words = [str(sensor_xml), address, "left", "--robot-port", port]
        programs = [subprocess.Popen([*python, "tools.examples.mujoco.serve", *words])]
        try:
            with ts.listen(address, "left") as results:
                wait_until(lambda: along_mm(results) >= 0, 120)
                words = [address, "left", "--robot", f"127.0.0.1:{port}"]
                follow = [*python, "tools.examples.servo.follow_surface", *words]
                programs.append(subprocess.Popen(follow))
                wait_until(lambda: along_mm(results) > 1, 120)
            for program in reversed(programs):
                program.send_signal(signal.SIGINT)
                assert program.wait(patience(20)) == 0
        finally:
            for program in programs:
                program.kill()
                program.wait()
