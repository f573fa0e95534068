"""The robot's clock and poses, shared by the thread that receives them and those that use them."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

from tacshade_edge.core.stitching.poses import PoseBuffer
from tacshade_edge.protocol.serial.clock_sync import ClockSync, SyncState
from tacshade_edge.protocol.serial.link import PoseArrived
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Pose


class RobotMotion:
    """Where the sensor was and when. Any thread may use it; no call waits more than a few microseconds."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sync = ClockSync()
        self._poses = PoseBuffer()
        self._restarts = 0

    def restart(self) -> None:
        """Start over with another clock: the robot sent its greeting."""
        with self._lock:
            self._sync.restart(Reason(ReasonCode.ROBOT_RESTARTED, "the robot restarted"))
            self._forget_old()

    def sync_received(self, t1_ns: int, t2_ns: int, t4_ns: int | None) -> None:
        """Take a ``SYNC`` that arrived; `sync_answered` must follow."""
        with self._lock:
            self._sync.sync_received(t1_ns, t2_ns, t4_ns)
            self._forget_old()

    def sync_answered(self, t3_ns: int) -> None:
        """Take the time at which the reply to the ``SYNC`` was given to the port."""
        with self._lock:
            self._sync.sync_answered(t3_ns)

    def add(self, arrived: PoseArrived) -> None:
        """Add a pose that arrived."""
        sample = arrived.sample
        with self._lock:
            self._sync.stamp_received(sample.t_ns, arrived.arrived_ns)
            self._forget_old()
            self._poses.add(Pose(sample.t_ns, *sample.values))

    def at(self, t_ns: int) -> tuple[Pose, int] | None:
        """``base_T_flange`` at a time of CLOCK_MONOTONIC, and its greatest time error in µs; None if unknown."""
        with self._lock:
            robot = self._sync.to_robot(t_ns)
            sample = None if robot is None else self._poses.at(robot.t_ns)
        if robot is None or sample is None:
            return None
        return replace(sample.pose, t_ns=t_ns), -(-(robot.error_ns + sample.extrapolated_ns) // 1000)

    def state(self) -> SyncState:
        """State of the clock synchronisation."""
        with self._lock:
            return self._sync.state()

    def as_dict(self) -> dict[str, Any]:
        """The counts for ``health``."""
        with self._lock:
            state, counts, late = self._sync.state(), self._sync.counts, self._poses.late
            return {
                "sync": state.mode,
                "offset_ns": state.offset_ns,
                "drift_ppm": state.drift_ppm,
                "error_us": state.error_us,
                "exchanges": counts.exchanges,
                "exchanges_refused": counts.exchanges_refused,
                "exchange_outliers": counts.outliers,
                "clock_restarts": counts.restarts,
                "poses_late": late,
            }

    def _forget_old(self) -> None:
        """Drop the poses of an earlier clock."""
        if self._restarts != self._sync.counts.restarts:
            self._restarts = self._sync.counts.restarts
            self._poses.clear()
