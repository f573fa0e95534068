"""Stitching in the daemon: its thread, ``req/stitch`` and ``status/stitching``; present only if frames have poses."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from tacshade_edge.daemon.pipeline.observer import STITCHED_S, FrameObserver, FrameResult
from tacshade_edge.daemon.requests import Reply
from tacshade_edge.daemon.stitching.map_publisher import MapPublisher
from tacshade_edge.daemon.stitching.session_worker import SessionWorker
from tacshade_edge.protocol.messages import encode_status
from tacshade_edge.protocol.requests import Request
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Need

if TYPE_CHECKING:
    from tacshade_edge.daemon.robot.robot import Robot  # imports pyserial

_REPORTED = ("name", "presses", "points", "revision", "missed", "folder")


class SessionRequests(FrameObserver):
    """The App's side of `SessionWorker`; only the main thread uses it, except for `see`.

    Parameters
    ----------
    folder : Path
        Folder of the sessions.
    sensor_id : str
        Sensor that the sessions belong to.
    publish : callable
        ``publish(topic, payload)``, retained; from any thread.
    reply : Reply
        Called from any thread.
    robot : Robot or None
        Adds poses to frames and commands sessions too; without one, the source's frames have poses.
    """

    health_key = "stitching"
    stop_s = STITCHED_S

    def __init__(
        self, folder: Path, sensor_id: str, publish: Callable[[str, bytes], None], reply: Reply, robot: Robot | None
    ) -> None:
        publish_map = MapPublisher(publish).publish
        if robot:
            self._worker = SessionWorker(folder, sensor_id, publish_map, robot.with_interpolated_pose)
            robot.commands.sessions = self._worker
        else:
            self._worker = SessionWorker(folder, sensor_id, publish_map)
        self._publish = publish
        self._reply = reply
        self._robot = robot
        self._published = b""
        # A daemon thread: the end of a session, or a disk that hangs, must not keep the process.
        self._thread = threading.Thread(target=self._worker.run, name="stitch", daemon=True)

    def start(self) -> None:
        """Resume a session that was open, and serve commands."""
        self._thread.start()

    def stop(self, timeout_s: float) -> None:
        """Add what waits; an open session, or one whose end takes longer, stays open on the disk."""
        self._worker.stop()
        self._thread.join(timeout_s)
        self.poll()

    def need(self) -> Need:
        """Depth, while a session is open."""
        return Need.DEPTH if self._worker.open else Need.CONTACT

    def see(self, seen: FrameResult) -> None:
        """Check whether a frame is a press."""
        if seen.reconstruction is not None and seen.calibration is not None:
            self._worker.observe(seen.frame, seen.reconstruction, seen.calibration)

    def handle(self, request: Request) -> None:
        """Start what ``req/stitch`` requests; its one reply comes when that is done."""
        self._worker.submit(request.action.upper(), request.name, lambda outcome: self._reply(request, outcome))

    def poll(self) -> None:
        """Refuse commands that have waited too long; publish ``status/stitching`` when it has changed."""
        self._worker.poll()
        session = self._worker.state
        state: str = "idle"
        reason: Reason | None = None
        if session.name:
            state, reason = "ending" if session.ending else "open", session.missed_reason
            if self._robot and not self._robot.knows_pose():
                reason = Reason(ReasonCode.NO_POSE, "the robot's pose is unknown, so no press can be added")
        details = {name: getattr(session, name) for name in _REPORTED}
        status = encode_status(state, reason, details)
        if status != self._published:
            self._published = status
            self._publish("status/stitching", status)

    def health(self) -> dict[str, int]:
        """The worker's counts."""
        return self._worker.as_dict()
