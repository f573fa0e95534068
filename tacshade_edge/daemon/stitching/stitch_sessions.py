"""Stitching in the daemon: its thread, ``req/stitch`` and ``status/stitching``; there only where frames have poses."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacshade_edge.daemon.pipeline.ledger import FrameOutcome
from tacshade_edge.daemon.pipeline.workers import Sink
from tacshade_edge.daemon.publishing.map_publisher import MapPublisher
from tacshade_edge.daemon.stitching.stitching import Stitching
from tacshade_edge.protocol.messages import Request, encode_error, encode_result, encode_status
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Calibration, Frame, Reconstruction

if TYPE_CHECKING:
    from tacshade_edge.daemon.robot.robot import Robot  # imports pyserial


class StitchSessions:
    """What the daemon has of `Stitching`; used by the main thread, but for `watched`.

    Parameters
    ----------
    folder : Path
        For sessions.
    publish : callable
        ``publish(topic, payload)``, retained; from any thread.
    reply : callable
        ``reply(request, payload)``; from any thread.
    robot : Robot or None
        Gives frames their poses and commands sessions too; without one the source's frames have poses.
    """

    def __init__(
        self,
        folder: Path,
        publish: Callable[[str, bytes], None],
        reply: Callable[[Request, bytes], None],
        robot: Robot | None,
    ) -> None:
        tell = MapPublisher(publish).tell
        self._stitching = Stitching(folder, tell, robot.with_settled_pose) if robot else Stitching(folder, tell)
        self._publish = publish
        self._reply = reply
        self._robot = robot
        if robot:
            robot.commands.stitching = self._stitching
        self._told = b""
        # A daemon thread: the end of a session, or a disk that hangs, must not keep the process.
        self._thread = threading.Thread(target=self._stitching.run, name="stitch", daemon=True)

    def start(self) -> None:
        """Go on with a session that was open, and serve commands."""
        self._thread.start()

    def stop(self, timeout_s: float) -> None:
        """Add what waits; an open session, or one whose end takes longer, stays open on the disk."""
        self._stitching.stop()
        self._thread.join(timeout_s)

    def watched(self, sink: Sink) -> Sink:
        """`sink`, whose results are looked at for presses."""
        return _WatchedSink(sink, self._stitching)

    def handle(self, request: Request) -> None:
        """Begin to do what ``req/stitch`` asks; its one reply comes when that is done."""

        def answer(code: str, text: str) -> None:
            if code:
                self._reply(request, encode_error(request.transaction, f"{code}: {text}"))
            else:
                self._reply(request, encode_result(request.transaction, values(text)))

        self._stitching.stitch(request.action.upper(), request.name, answer)

    def poll(self) -> None:
        """Refuse what waits in vain; tell ``status/stitching`` when it changed."""
        self._stitching.poll()
        now = self._stitching.now
        state, reason = "idle", ""
        if now.name:
            state = "ending" if now.ending else "open"
            reason = now.reason
            if self._robot and not self._robot.knows_pose():
                reason = "the robot's pose is not known: nothing can be added"
        counts = {"presses": now.presses, "points": now.points, "revision": now.revision, "missed": now.missed}
        why = Reason(ReasonCode.UNAVAILABLE, reason) if reason else None
        status = encode_status(state, why, {"name": now.name, **counts, "folder": now.folder})
        if status != self._told:
            self._told = status
            self._publish("status/stitching", status)

    def as_dict(self) -> dict[str, int]:
        """For ``health``."""
        return self._stitching.as_dict()


class _WatchedSink:
    def __init__(self, sink: Sink, stitching: Stitching) -> None:
        self._sink = sink
        self._stitching = stitching

    def needs_depth(self) -> bool:
        return self._stitching.open or self._sink.needs_depth()

    def deliver(self, frame: Frame, result: Reconstruction | None, calibration: Calibration) -> FrameOutcome | None:
        outcome = self._sink.deliver(frame, result, calibration)
        if result is not None:
            self._stitching.reconstructed(frame, result, calibration)
        return outcome


def values(text: str) -> dict[str, Any]:
    """``key=value`` words as a mapping: numbers as numbers, but a name is a text whatever it looks like."""
    pairs = (word.partition("=") for word in text.split())
    return {key: value if key == "name" else _number(value) for key, _, value in pairs}


def _number(text: str) -> int | float:
    return float(text) if "." in text else int(text)
