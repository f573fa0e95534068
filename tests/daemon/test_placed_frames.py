"""A robot that sends its places in m is told so, on its line and in ``status/serial``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from support.calibrated_sensor import calibrated
from support.patience import wait_until
from support.robot import PtyRobot
from support.robot_side import Side
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.types import (
    Frame,
    HeightMap,
    ObjectCloud,
    Pose,
    Reconstruction,
    TouchedObject,
)

IMAGE = np.zeros((2, 2), np.uint8)


def seen(k: int, z_mm: float, unit_mm: float) -> FrameResult:
    """A frame of a robot at this height over a flat plate, as it sends its place in a unit."""
    height = HeightMap(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.bool_), 0, 0, 1)
    cloud = ObjectCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16))
    contact = z_mm < 0
    objects = (TouchedObject(1, (0, 0, 20), (0, 0, 0), -z_mm, 2.0),) if contact else ()
    t_ns = k * 33_000_000
    pose = Pose(t_ns, 400 / unit_mm, 0.0, z_mm / unit_mm, 1.0, 0.0, 0.0, 0.0)
    found = Reconstruction(
        k, t_ns, 0, "fast", True, None, contact, False, None, height, cloud, objects=objects
    )
    return FrameResult(Frame(k, t_ns, 0, IMAGE, pose), calibrated(), found)


def test_places_in_inches_are_said_as_well(link: Path) -> None:
    way = [10 - k / 5 for k in range(50)] + [-k / 5 for k in range(12)] + list(range(10))
    with PtyRobot(link, rate_hz=100, binary=True) as robot, Side(link) as side:
        side.until("synchronised", state="connected", sync="two-way", reason_code="")
        for k, z_mm in enumerate(way * 4):
            side.robot.see(seen(k, z_mm, 25.4))
        said = side.until("in inches", state="connected", reason_code="pose_unit")
        assert "are they in inches?" in said["reason"]
        wait_until(lambda: any(e.startswith("POSE ") for e in robot.events), 10, "EVT POSE")
        assert [e for e in robot.events if e.startswith("POSE ")] == [
            "POSE span_mm=0.48 unit=inches expected=mm"
        ]


def test_places_in_metres_are_said_until_they_are_in_mm(link: Path) -> None:
    way = [10 - k for k in range(10)] + [-k / 5 for k in range(12)] + list(range(10))
    with PtyRobot(link, rate_hz=100, binary=True) as robot, Side(link) as side:
        side.until("synchronised", state="connected", sync="two-way", reason_code="")
        for k, z_mm in enumerate(way * 4):
            side.robot.see(seen(k, z_mm, 1000.0))
        said = side.until("in m", state="connected", reason_code="pose_unit")
        assert "are they in m?" in said["reason"]
        wait_until(lambda: any(e.startswith("POSE ") for e in robot.events), 10, "EVT POSE")
        assert [e for e in robot.events if e.startswith("POSE ")] == [
            "POSE span_mm=0.012 unit=m expected=mm"
        ]
        for k, z_mm in enumerate(way):
            side.robot.see(seen(1000 + k, z_mm, 1.0))
        side.until("in mm", state="connected", reason_code="")
