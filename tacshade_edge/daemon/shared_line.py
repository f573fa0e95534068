"""Lets several sensors' processes share a robot's line: one has the port and forwards what it learns of the robot.

It forwards what `RobotMotion` takes, so that all have the same clock and the same poses; commands and their answers
stay with the process that has the port. Each follower has its own pair of datagram sockets, made before the processes
are forked, and nobody waits for a follower: a pose that finds no room is lost to it.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from tacshade_edge.daemon.serial_line import SILENT_NS, PortState, RobotMotion
from tacshade_edge.protocol.serial.framing import Mode
from tacshade_edge.protocol.serial.link import PoseArrived
from tacshade_edge.protocol.serial.pose import PoseSample
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.settings import Document

_BYTES_MAX: Final = 1 << 14
_READ_S: Final = 0.05
_PORT_PERIOD_NS: Final = 1_000_000_000


class _Pose(msgspec.Struct, frozen=True, tag=1, array_like=True):
    sample: PoseSample
    arrived_ns: int


class _Sync(msgspec.Struct, frozen=True, tag=2, array_like=True):
    """A whole exchange, so that the halves of two never mix."""

    t1_ns: int
    t2_ns: int
    t4_ns: int | None
    t3_ns: int


class _Restart(msgspec.Struct, frozen=True, tag=3, array_like=True):
    pass


class _Port(msgspec.Struct, frozen=True, tag=4, array_like=True):
    state: PortState
    mode: Mode
    quiet_since_ns: int
    counts: dict[str, Any]


_decoder: Final = msgspec.msgpack.Decoder(_Pose | _Sync | _Restart | _Port)


@dataclass(frozen=True, slots=True, eq=False)
class SharedLine:
    """A sensor's part in a shared line: the owner's `ends`, or the socket on which a follower `hears` the owner."""

    owner: str
    ends: tuple[socket.socket, ...] = ()
    hears: socket.socket | None = None


def share_lines(documents: Sequence[Document]) -> dict[str, SharedLine]:
    """Each sensor's part in a port that several name; the first of them has the port. Other sensors are left out."""
    names: dict[str, list[str]] = {}
    for document in documents:
        if (serial := document.settings.serial) is not None:
            names.setdefault(serial.device, []).append(document.settings.sensor_id)
    shared: dict[str, SharedLine] = {}
    for owner, *followers in names.values():
        ends = []
        for name in followers:
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            ours.setblocking(False)
            ends.append(ours)
            shared[name] = SharedLine(owner, hears=theirs)
        if followers:
            shared[owner] = SharedLine(owner, tuple(ends))
    return shared


class ForwardingMotion(RobotMotion):
    """A `RobotMotion` that forwards what it takes."""

    def __init__(self, ends: Sequence[socket.socket]) -> None:
        super().__init__()
        self._ends = ends
        self._received: tuple[int, int, int | None] | None = None
        self._port: _Port | None = None
        self._port_reported_ns = 0

    def restart(self) -> None:
        super().restart()
        self._forward(_Restart())

    def sync_received(self, t1_ns: int, t2_ns: int, t4_ns: int | None) -> None:
        super().sync_received(t1_ns, t2_ns, t4_ns)
        self._received = (t1_ns, t2_ns, t4_ns)

    def sync_answered(self, t3_ns: int) -> None:
        super().sync_answered(t3_ns)
        if self._received is not None:
            self._forward(_Sync(*self._received, t3_ns))

    def add(self, arrived: PoseArrived) -> None:
        super().add(arrived)
        self._forward(_Pose(arrived.sample, arrived.arrived_ns))

    def forward_port(self, state: PortState, mode: Mode, quiet_since_ns: int, counts: dict[str, Any]) -> None:
        """Forward the port's state: a change at once, otherwise once a second."""
        now_ns = time.monotonic_ns()
        changed = self._port is None or (state, mode) != (self._port.state, self._port.mode)
        if changed or now_ns - self._port_reported_ns >= _PORT_PERIOD_NS:
            self._port, self._port_reported_ns = _Port(state, mode, quiet_since_ns, counts), now_ns
            self._forward(self._port)

    def _forward(self, message: msgspec.Struct) -> None:
        payload = msgspec.msgpack.encode(message)
        for end in self._ends:
            with contextlib.suppress(OSError):
                end.send(payload)


class FollowingChannel:
    """Replaces a `SerialChannel` if another sensor has the port, whose name is in the details of `port_state`."""

    def __init__(self, owner: str, hears: socket.socket, motion: RobotMotion) -> None:
        self.port_state = PortState("away", Reason(ReasonCode.STARTING, "starting"), {"shared_by": owner})
        self.quiet_since_ns = 0
        self.mode: Mode = "ASCII"
        self._owner = owner
        self._hears = hears
        self._motion = motion
        self._counts: dict[str, Any] = {}
        self._stop = threading.Event()

    def stop(self) -> None:
        self._stop.set()

    def as_dict(self) -> dict[str, Any]:
        return dict(self._counts)

    def run(self) -> None:
        self._hears.settimeout(_READ_S)
        heard_ns = time.monotonic_ns()
        while not self._stop.is_set():
            try:
                payload = self._hears.recv(_BYTES_MAX)
            except TimeoutError:
                if time.monotonic_ns() - heard_ns > SILENT_NS and self.port_state.state == "open":
                    reason = Reason(ReasonCode.NO_ANSWER, f"{self._owner}, which owns the port, is sending nothing")
                    self.port_state = PortState("away", reason, {"shared_by": self._owner})
                continue
            match _decoder.decode(payload):
                case _Pose(sample, arrived_ns):
                    self._motion.add(PoseArrived(sample, arrived_ns, 0))
                case _Sync(t1_ns, t2_ns, t4_ns, t3_ns):
                    self._motion.sync_received(t1_ns, t2_ns, t4_ns)
                    self._motion.sync_answered(t3_ns)
                case _Restart():
                    self._motion.restart()
                case _Port(state, mode, quiet_since_ns, counts):
                    heard_ns = time.monotonic_ns()
                    self.mode, self.quiet_since_ns, self._counts = mode, quiet_since_ns, counts
                    details = {**state.details, "shared_by": self._owner}
                    self.port_state = PortState(state.state, state.reason, details)
