"""Where the sensor was and when: the robot's clock and poses, from what was heard of the robot.

A process that shares the robot's line gets the same messages from the port's owner, so they are
structs that `msgspec` encodes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgspec

from tacshade_edge.robot.clock_sync import ClockSync, SyncState
from tacshade_edge.robot.pose import PoseSample
from tacshade_edge.robot.pose_buffer import PoseBuffer
from tacshade_edge.types import Pose


class PoseHeard(msgspec.Struct, frozen=True, tag=1, array_like=True):
    """A pose from the robot, and when it arrived."""

    sample: PoseSample
    arrived_ns: int


class ClockExchanged(msgspec.Struct, frozen=True, tag=2, array_like=True):
    """A ``SYNC`` and its reply: when the robot sent it, it arrived,
    the reply and the previous reply arrived.
    """

    t1_ns: int
    t2_ns: int
    t3_ns: int
    t4_ns: int | None


class RobotRestarted(msgspec.Struct, frozen=True, tag=3, array_like=True):
    """The robot sent its greeting, so it has another clock."""


Heard = PoseHeard | ClockExchanged | RobotRestarted


class RobotMotion:
    """Where the sensor was and when, from what was `Heard` of the robot; `forward` passes that on
    to other sensors. Any thread may use it.
    """

    def __init__(self, forward: Callable[[Heard], None] = lambda heard: None) -> None:
        self._forward = forward
        self._lock = threading.Lock()
        self._sync = ClockSync()
        self._poses = PoseBuffer()
        self._restarts = 0

    def hear(self, heard: Heard) -> None:
        with self._lock:
            if isinstance(heard, PoseHeard):
                self._sync.stamp_received(heard.sample.t_ns, heard.arrived_ns)
            elif isinstance(heard, ClockExchanged):
                self._sync.sync_received(heard.t1_ns, heard.t2_ns, heard.t4_ns)
                self._sync.sync_answered(heard.t3_ns)
            else:
                self._sync.robot_restarted()
            # Clock first, pose last: a stamp may itself show that the clock jumped, and then the
            # poses before it are of another clock while this one is of the new.
            if self._restarts != self._sync.counts.restarts:
                self._restarts = self._sync.counts.restarts
                self._poses.clear()
            if isinstance(heard, PoseHeard):
                self._poses.add(Pose(heard.sample.t_ns, *heard.sample.values))
        # Outside the lock: a socket's send must not delay a frame that asks for its pose.
        self._forward(heard)

    def at(self, t_ns: int) -> tuple[Pose, int] | None:
        """``base_T_flange`` at a time of CLOCK_MONOTONIC, and its greatest time error in µs;
        None if unknown.
        """
        # One lock for both: between a restart of the clock and the clearing of the poses, a time
        # would be looked up among poses of another clock.
        with self._lock:
            robot = self._sync.to_robot(t_ns)
            sample = None if robot is None else self._poses.at(robot.t_ns)
        if robot is None or sample is None:
            return None
        # Rounded up: an error may be overstated, never understated.
        error_us = -(-(robot.error_ns + sample.extrapolated_ns) // 1000)
        return replace(sample.pose, t_ns=t_ns), error_us

    def state(self) -> SyncState:
        with self._lock:
            return self._sync.state()

    def as_dict(self) -> dict[str, Any]:
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
