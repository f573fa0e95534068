"""The examples of a servo: a surface and an edge followed, and a robot that stops."""

from __future__ import annotations

import math
import socket

import numpy as np
import pytest

from tacshade_edge.rigid import shift, turn
from tools.examples.servo.follow_edge import FollowEdge
from tools.examples.servo.follow_surface import FollowSurface
from tools.examples.servo.robot import Robot
from tools.testbed.servo.skins import MODEL
from tools.testbed.servo.world import LateRobot

FRAME_S = 1 / 60
R_MM = MODEL.skin_radius_mm


@pytest.mark.parametrize("late_frames", [1, 7])
def test_a_tilted_plane_is_met_at_right_angles_and_at_the_depth_although_the_robot_obeys_late(
    late_frames: int,
) -> None:
    normal = np.array((0.15, 0.1, -1.0)) / math.sqrt(1 + 0.15**2 + 0.1**2)
    follow, start = FollowSurface(1.5, 10.0), shift(0, 0, R_MM - 1.0) @ turn((math.pi, 0, 0))
    robot = LateRobot(start, late_frames * FRAME_S, 0.0)

    def touch() -> dict[str, float]:
        n = robot.pose.rotation.T @ normal
        return {
            "depth_mm": R_MM + float(normal @ robot.pose.translation_mm),
            "tilt_x_deg": -math.degrees(math.asin(n[1])),
            "tilt_y_deg": math.degrees(math.atan2(n[0], n[2])),
        }

    assert math.hypot(touch()["tilt_x_deg"], touch()["tilt_y_deg"]) > 9
    for frame in range(1, 300):
        robot.hear(frame * FRAME_S, np.array(follow.velocity(touch(), FRAME_S)))
        robot.go_on((frame + 1) * FRAME_S)
    end = touch()
    assert abs(end["depth_mm"] - 1.5) < 0.02
    assert abs(end["tilt_x_deg"]) < 0.2
    assert abs(end["tilt_y_deg"]) < 0.2
    assert robot.pose.translation_mm[0] > 40


def test_towards_the_edge_and_turned_along_it() -> None:
    velocity = FollowEdge(1.5, 10.0).velocity({"depth_mm": 1.0, "y_mm": 2.0, "edge_deg": -5.0}, 0.0)
    along = 10.0 * math.tan(math.radians(-5.0))
    assert velocity == pytest.approx((10.0, along + 8.0, 2.0, 0.0, 0.0, -20.0))


def test_a_robot_stops_when_it_is_not_sent_on() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        line.settimeout(10)
        with Robot(f"127.0.0.1:{line.getsockname()[1]}") as robot:
            robot.move((10.0, 0.0, 0.0, 0.0, 0.0, 0.0))
            words = [line.recv(256) for _ in range(2)]
    assert [float(word.split()[0]) for word in words] == [10.0, 0.0]
