"""The thread `stitch`, and its inputs from other threads: commands for sessions, and frames that may be presses.

Everything that touches a session runs there: the map, the disk, the end, which takes seconds. The reconstruct thread
only decides whether a frame is a press, and passes its points on.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Literal

import numpy as np

from tacshade_edge.core.stitching.press_points import PressPoints, RestDetector, press_points
from tacshade_edge.daemon.observer import STITCHED_S, WAITING_MAX, FrameObserver, FrameResult, FrameWaiters
from tacshade_edge.daemon.requests import Reply
from tacshade_edge.daemon.session import MapPublisher, MapRevision, Session
from tacshade_edge.errors import DeviceError, TacshadeError
from tacshade_edge.free_memory import return_free_memory
from tacshade_edge.protocol.messages import encode_status
from tacshade_edge.protocol.requests import Request
from tacshade_edge.protocol.results import (
    NoSession,
    PressAdded,
    SessionAborted,
    SessionBegun,
    SessionEnded,
    SessionResult,
)
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import Rigid, from_seven, of_pose
from tacshade_edge.storage.atomic_files import FolderLock, disk_errors
from tacshade_edge.types import Calibration, Frame, Need, Reconstruction

if TYPE_CHECKING:
    from tacshade_edge.daemon.robot import Robot  # imports pyserial


SessionReply = Callable[[SessionResult | Reason], None]
"""``reply(outcome)``, called once: a command's result, or the reason that there is none."""


_log = logging.getLogger(__name__)

DEFERRED_S = 0.25
_NO_IMAGE = np.zeros((0, 0), np.uint8)


@dataclass(frozen=True, slots=True)
class SessionState:
    """The state of the sessions at one instant; while `ending`, the map is being made.

    `missed` contacts at rest could not be added to the latest session, the latest for `missed_reason`.
    """

    name: str = ""
    ending: bool = False
    presses: int = 0
    points: int = 0
    revision: int = 0
    missed: int = 0
    missed_reason: Reason | None = None
    folder: str = ""


@dataclass(frozen=True, slots=True)
class _Job:
    run: Callable[[], SessionResult]
    reply: SessionReply


class SessionWorker:
    """One sensor's sessions, one at a time, each in its own folder below `folder`.

    A session that was open when the daemon died is resumed. While another process owns the folder, there are no
    sessions. `publish_map` is called after each press and at the end, and returns True if it was deferred: the map is
    then published a moment later, as it is by then. `with_pose` adds the pose to a frame and may wait a moment. Both
    are called in this object's thread. If `automatic`, every contact that comes to rest while a session is open is
    added.
    """

    def __init__(
        self,
        folder: Path,
        sensor_id: str,
        publish_map: Callable[[MapRevision], bool | None],
        with_pose: Callable[[Frame], Frame] = lambda frame: frame,
        *,
        automatic: bool = True,
    ) -> None:
        self._folder = folder
        self._sensor_id = sensor_id
        self._folder_lock: FolderLock | None = None
        self._publish_map = publish_map
        self._with_pose = with_pose
        self._automatic = automatic
        self._jobs: SimpleQueue[_Job | Literal["stop"]] = SimpleQueue()
        self._adds: FrameWaiters[SessionReply] = FrameWaiters("presses are already waiting for a frame")
        self._lock = threading.Lock()
        self._rest = RestDetector()
        self._calibration: Calibration | None = None
        self._session: Session | None = None
        self._counts = {"presses": 0, "refused": 0, "missed": 0}
        self._missed = 0
        self._missed_reason: Reason | None = None
        self._map_folder = ""
        self._deferred = False
        self._state = SessionState()  # replaced in the thread; the others read it

    @property
    def state(self) -> SessionState:
        with self._lock:
            return replace(self._state, missed=self._missed, missed_reason=self._missed_reason)

    @property
    def open(self) -> bool:
        """Whether a session is open: every frame's depth is then reconstructed."""
        return bool(self._state.name)

    def as_dict(self) -> dict[str, int]:
        """Counts for ``health``: presses added, commands to add one refused, contacts at rest missed, jobs waiting."""
        with self._lock:
            return {**self._counts, "waiting": len(self._adds) + self._jobs.qsize()}

    # Other threads call these; none of them waits.

    def submit(self, action: str, name: str, reply: SessionReply) -> None:
        """Carry out ``BEGIN``, ``ADD``, ``END``, ``ABORT`` or ``STATUS``; the reply comes later, from any thread."""
        if action == "ADD":
            reply = self._counting_refusals(reply)
        if action == "ADD" and self.open:
            self._adds.put(time.monotonic_ns(), reply)
        elif self._jobs.qsize() >= WAITING_MAX:
            reply(Reason(ReasonCode.BUSY, f"{WAITING_MAX} commands are already waiting"))
        else:
            self._jobs.put(_Job(partial(self._command, action, name), reply))

    def observe(self, frame: Frame, result: Reconstruction, calibration: Calibration) -> None:
        """Add the frame if an ``ADD`` waits for it, or if its contact has come to rest."""
        self._calibration = calibration
        if not self.open:
            return
        at_rest = self._rest.update(result.t_ns, result.valid and result.contact, result.depth_max_mm)
        replies = self._adds.take(frame.t_ns)
        if not replies and at_rest and self._automatic:
            replies = [self._automatic_reply]
        if not replies:
            return
        refusal = _refusal(result)
        if refusal is None and self._jobs.qsize() >= WAITING_MAX:
            refusal = Reason(ReasonCode.BUSY, f"{WAITING_MAX} presses are already waiting")
        if refusal is not None:
            for reply in replies:
                reply(refusal)
            return
        self._rest.suppress()
        points = press_points(result.height, calibration.geometry)
        flange_T_sensor = from_seven(calibration.flange_T_sensor)
        # The same frame twice would be the same press twice.
        add = partial(self._add, points, replace(frame, image=_NO_IMAGE), flange_T_sensor)
        self._jobs.put(_Job(add, replies[0]))
        for reply in replies[1:]:
            reply(Reason(ReasonCode.BUSY, f"frame {result.seq} is already being added"))

    def poll(self) -> None:
        """Refuse commands that have waited too long for a frame; called now and then."""
        self._adds.expire(time.monotonic_ns())

    def stop(self) -> None:
        """Make `run` return after the waiting jobs; an open session stays open on the disk."""
        self._jobs.put("stop")

    def _counting_refusals(self, reply: SessionReply) -> SessionReply:
        def counting(outcome: SessionResult | Reason) -> None:
            if isinstance(outcome, Reason):
                with self._lock:
                    self._counts["refused"] += 1
            reply(outcome)

        return counting

    def _automatic_reply(self, outcome: SessionResult | Reason) -> None:
        """Take the outcome for a contact at rest, which nobody waits for."""
        if not isinstance(outcome, Reason):
            with self._lock:
                self._missed_reason = None
            return
        _log.warning("did not add a settled contact: %s", outcome)
        with self._lock:
            self._missed_reason = Reason(outcome.code, f"did not add the latest contact: {outcome}")
            self._missed += 1
            self._counts["missed"] += 1

    # The thread runs these.

    def run(self) -> None:
        """Resume an open session, then do one job after another until `stop`."""
        self._resume()
        while (job := self._next_job()) != "stop":
            if job is None:
                if self._session is not None:
                    self._publish(self._session.map_revision())
                continue
            outcome: SessionResult | Reason
            try:
                outcome = job.run()
            except TacshadeError as error:
                outcome = error.reason
            self._state = self._current_state()
            job.reply(outcome)
            if isinstance(outcome, SessionEnded | SessionAborted):
                return_free_memory()  # a full map took 300 MB
        if self._session is not None:
            self._session.close()
        if self._folder_lock is not None:
            self._folder_lock.release()

    def _next_job(self) -> _Job | Literal["stop"] | None:
        """The next job; None when it is time to publish a deferred map."""
        try:
            return self._jobs.get(timeout=DEFERRED_S if self._deferred else None)
        except Empty:
            return None

    def _publish(self, revision: MapRevision) -> None:
        self._deferred = bool(self._publish_map(revision))

    def _resume(self) -> None:
        try:
            with disk_errors(self._folder):
                if not self._folder.is_dir():  # the first session makes it
                    return
            self._own_folder()
            session = Session.resume(self._folder, self._sensor_id)
        except TacshadeError as error:
            _log.warning("cannot resume the session: %s", error)
            return
        if session is None:
            return
        self._session = session
        self._state = self._current_state()
        if session.presses:
            self._publish(session.map_revision())
        _log.info("session %s continues with %d presses", session.name, session.presses)

    def _own_folder(self) -> None:
        if self._folder_lock is None:
            self._folder_lock = FolderLock(self._folder, f"sensor {self._sensor_id}")

    def _command(self, action: str, name: str) -> SessionResult:
        session = self._session
        if action == "BEGIN":
            return self._begin(name)
        if action == "STATUS":
            return NoSession() if session is None else session.status(self._missed)
        if session is None:
            raise DeviceError("no session is open; begin one first", code=ReasonCode.NO_SESSION)
        if action == "END":
            return self._end(session)
        if action == "ABORT":
            return self._abort(session)
        raise DeviceError("the session has only just started; add the press again", code=ReasonCode.NO_SESSION)

    def _begin(self, name: str) -> SessionResult:
        if self._folder_lock is None:
            self._own_folder()
            self._resume()
        if self._session is not None and self._session.gone:
            _log.warning("deleted session %s with %d presses", self._session.name, self._session.presses)
            self._session.close()
            self._clear_session()
        if self._session is not None:
            text = f"session {self._session.name} is open; end or abort it first"
            raise DeviceError(text, code=ReasonCode.BUSY)
        if self._calibration is None:
            raise DeviceError("no frame has been reconstructed yet", code=ReasonCode.NO_FRAME)
        session = Session.begin(self._folder, name, self._calibration, self._sensor_id)
        self._session, self._rest = session, RestDetector()
        with self._lock:
            self._missed, self._missed_reason = 0, None
        self._state = self._current_state()
        _log.info("started stitching session %s", session.name)
        return SessionBegun(session.name)

    def _add(self, points: PressPoints, frame: Frame, flange_T_sensor: Rigid) -> PressAdded:
        session, seq = self._session, frame.seq
        if session is None:
            raise DeviceError("the session has ended", code=ReasonCode.NO_SESSION)
        if len(points.points_mm) == 0:
            raise DeviceError(f"frame {seq}: nothing is touching the sensor", code=ReasonCode.NO_CONTACT)
        if (pose := self._with_pose(frame).pose) is None:
            raise DeviceError(f"frame {seq}: the robot's pose at the frame's time is unknown", code=ReasonCode.NO_POSE)
        added = session.add(points, of_pose(pose) @ flange_T_sensor, seq)
        with self._lock:
            self._counts["presses"] += 1
        self._publish(session.map_revision())
        return added

    def _end(self, session: Session) -> SessionEnded:
        if session.presses == 0:
            raise DeviceError("the session has no presses; use ABORT to end it", code=ReasonCode.NO_PRESS)
        self._state = replace(self._current_state(), ending=True)
        ended, final_map = session.finish(self._missed)
        self._map_folder = str(session.folder)
        self._clear_session()
        self._publish(final_map)
        return ended

    def _abort(self, session: Session) -> SessionAborted:
        aborted = session.abort()
        self._clear_session()
        return aborted

    def _clear_session(self) -> None:
        self._session = None
        self._deferred = False
        self._state = self._current_state()
        self._adds.refuse_all(Reason(ReasonCode.NO_SESSION, "the session has ended"))

    def _current_state(self) -> SessionState:
        session, folder = self._session, self._map_folder
        if session is None:
            return SessionState(folder=folder)
        return SessionState(
            session.name, presses=session.presses, points=session.points, revision=session.revision, folder=folder
        )


def _refusal(result: Reconstruction) -> Reason | None:
    if not result.valid:
        return Reason(ReasonCode.FRAME_INVALID, f"frame {result.seq}: {result.reason}")
    if not result.contact:
        return Reason(ReasonCode.NO_CONTACT, f"frame {result.seq}: nothing is touching the sensor")
    return None


_REPORTED = ("name", "presses", "points", "revision", "missed", "folder")


class SessionRequests(FrameObserver):
    """``req/stitch`` and ``status/stitching``; present only if frames have poses: of the robot, or of their source."""

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
        self._thread.start()

    def stop(self, timeout_s: float) -> None:
        """Add what waits; an open session, or one whose end takes longer, stays open on the disk."""
        self._worker.stop()
        self._thread.join(timeout_s)
        self.poll()

    def need(self) -> Need:
        return Need.DEPTH if self._worker.open else Need.CONTACT

    def see(self, seen: FrameResult) -> None:
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
        return self._worker.as_dict()
