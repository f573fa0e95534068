"""The robot's serial line while ``tacshade-edge capture`` runs: it only delivers poses; requests have no effect."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator

from tacshade_edge.capture.robot_place import PoseAt
from tacshade_edge.factories import ports
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.settings import Serial
from tacshade_edge.types import Frame, Pose

_MISSING = Reason(ReasonCode.NOT_CALIBRATED, "not calibrated: tacshade-edge capture is taking references and presses")


@contextlib.contextmanager
def robot_poses(serial: Serial | None) -> Iterator[PoseAt | None]:
    """Serve the robot's serial line as the daemon does (docs/reference/serial.md); yields None without a robot."""
    if serial is None or (port := ports.make_serial_port(serial)) is None:
        yield None
        return
    from tacshade_edge.daemon.robot import Robot

    statuses: list[bytes] = []
    state = {"source": "streaming", "health": {}}
    robot = Robot(port, lambda request: None, lambda: state, statuses.append, lambda: _MISSING)

    def pose_at(frame: Frame) -> Pose | str:
        if (pose := robot.with_interpolated_pose(frame).pose) is not None:
            return pose
        robot.poll()
        status = json.loads(statuses[-1])
        why = status["reason"] or f"clock {status.get('sync')}"
        return f"the robot reported no pose for this picture ({serial.device} is {status['state']}: {why})"

    robot.start()
    try:
        yield pose_at
    finally:
        robot.stop(1.0)
