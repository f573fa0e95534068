"""Stitching sessions (``req/stitch``, ``status/stitching``):
the thread `stitch`, and what it gets from other threads.

Everything that touches a session runs there: the map, the disk, the end, which takes seconds. The
reconstruct thread only decides whether a frame is a press, and passes its points on.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tacshade_edge.errors import DeviceError, TacshadeError
from tacshade_edge.files.atomic_files import FolderLock, disk_errors
from tacshade_edge.free_memory import return_free_memory
from tacshade_edge.pipeline.observer import (
    STITCHED_S,
    STOPPING,
    WAITING_MAX,
    FrameObserver,
    FrameResult,
    FrameWaiters,
    Reply,
)
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import Rigid, from_seven, of_pose
from tacshade_edge.stitching.press_points import PressPoints, RestDetector, press_points
from tacshade_edge.stitching.session import MapPublisher, MapRevision, StitchSession
from tacshade_edge.stitching.session_jobs import SessionJobs
from tacshade_edge.types import Calibration, Frame, Need, Reconstruction
from tacshade_edge.wire.messages import encode_status
from tacshade_edge.wire.requests import Request
from tacshade_edge.wire.results import (
    NoSession,
    PressAdded,
    SessionAborted,
    SessionBegun,
    SessionEnded,
    SessionResult,
)

if TYPE_CHECKING:
    from tacshade_edge.robot.robot import Robot  # imports pyserial

_log = logging.getLogger(__name__)

# How soon a map is published that came within a second of the one before.
DEFERRED_S = 0.25
_NO_IMAGE = np.zeros((0, 0), np.uint8)


@dataclass(frozen=True, slots=True)
class SessionState:
    """The sessions at one instant, as ``status/stitching`` shows them;
    `missed` contacts at rest were not added.
    """

    name: str = ""
    presses: int = 0
    points: int = 0
    revision: int = 0
    missed: int = 0
    folder: str = ""  # of the latest map


class Sessions(FrameObserver):
    """One sensor's sessions, one at a time, each in its own folder below `folder`; present only if
    frames have poses. A session that was open when the daemon died is resumed. Every contact that
    comes to rest while one is open is added.
    """

    health_key = "stitching"
    stop_s = STITCHED_S

    def __init__(
        self,
        folder: Path,
        sensor_id: str,
        publish: Callable[[str, bytes], None],
        robot: Robot | None = None,
    ) -> None:
        self._folder = folder
        self._sensor_id = sensor_id
        self._folder_lock: FolderLock | None = None
        self._publish = publish
        # Called after each press and at the end; True if it was deferred,
        # and the map is published a moment later.
        self.publish_map: Callable[[MapRevision], bool] = MapPublisher(publish).publish
        self._robot = robot
        if robot:
            robot.commands.stitch = self.submit
        self._jobs = SessionJobs()
        self._adds = FrameWaiters("presses are already waiting for a frame")
        self._lock = threading.Lock()
        self._rest = RestDetector()
        self._calibration: Calibration | None = None
        self._session: StitchSession | None = None
        self._counts = {"presses": 0, "refused": 0, "missed": 0}
        self._missed = 0  # in the latest session
        self._missed_reason: Reason | None = None
        self._map_folder = ""
        self._deferred = False
        self._state = SessionState()  # replaced in the thread; the others read it
        self._ending = self._stopping = False  # making the map; refusing commands
        self._published = b""
        # A daemon thread: the end of a session, or a disk that hangs, must not keep the process.
        self._thread = threading.Thread(target=self._run, name="stitch", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout_s: float) -> None:
        """Add what waits; an open session, or one whose end takes longer and is refused,
        stays open on the disk.
        """
        self._stopping = True
        self._jobs.stop()
        self._thread.join(timeout_s)
        self._adds.refuse_all(STOPPING)
        self._jobs.refuse_all()
        self.poll()

    def need(self) -> Need:
        return Need.DEPTH if self._state.name else Need.CONTACT

    def see(self, seen: FrameResult) -> None:
        if seen.reconstruction is not None and seen.calibration is not None:
            self._observe(seen.frame, seen.reconstruction, seen.calibration)

    def health(self) -> dict[str, int]:
        """Presses added, commands to add one refused, contacts at rest missed, jobs waiting."""
        with self._lock:
            return {**self._counts, "waiting": len(self._adds) + len(self._jobs)}

    def poll(self) -> None:
        """Refuse commands that have waited too long;
        publish ``status/stitching`` when it has changed.
        """
        self._adds.expire(time.monotonic_ns())
        with self._lock:
            session, reason = replace(self._state, missed=self._missed), self._missed_reason
        state: str = "idle"
        if not session.name:
            reason = None
        else:
            state = "ending" if self._ending else "open"
            if self._robot and not self._robot.knows_pose():
                reason = Reason(
                    ReasonCode.NO_POSE, "the robot's pose is unknown, so no press can be added"
                )
        status = encode_status(state, reason, asdict(session))
        if status != self._published:
            self._published = status
            self._publish("status/stitching", status)

    # Any thread calls these; none of them waits.

    def handle(self, request: Request, reply: Reply) -> None:
        self.submit(request.action.upper(), request.name, reply)

    def submit(self, action: str, name: str, reply: Reply) -> None:
        """Carry out ``BEGIN``, ``ADD``, ``END``, ``ABORT`` or ``STATUS``;
        the reply comes later, from any thread.
        """
        if action == "ADD":
            reply = partial(self._count_refusal, reply)
        if self._stopping:
            reply(STOPPING)
        elif action == "ADD" and self._state.name:
            # The press is the first frame taken after the command: the robot stands still by
            # then.
            self._adds.put(time.monotonic_ns(), reply)
        elif len(self._jobs) >= WAITING_MAX:
            reply(Reason(ReasonCode.BUSY, f"{WAITING_MAX} commands are already waiting"))
        else:
            self._jobs.put(partial(self._command, action, name), reply)

    def _observe(self, frame: Frame, result: Reconstruction, calibration: Calibration) -> None:
        """Add the frame if an ``ADD`` waits for it, or if its contact has come to rest."""
        # First of all that sees the frame: whoever hears of the first contact may begin a session
        # at once, which needs a calibration.
        self._calibration = calibration
        if not self._state.name:
            return
        # A frame of unknown depth is no press, and ends none.
        # In the reconstruct thread: the detector is only used here, and replaced when a session
        # begins.
        at_rest = not result.touched and self._rest.update(
            result.t_ns, result.valid and result.contact, result.depth_max_mm
        )
        replies = self._adds.take(frame.t_ns)
        if not replies and at_rest:
            replies = [self._note_missed]
        if not replies:
            return
        refusal: Reason | None = None
        if not result.valid:
            refusal = Reason(ReasonCode.FRAME_INVALID, f"frame {result.seq}: {result.reason}")
        elif result.touched:
            text = f"frame {result.seq}: something touches, but its depth is unknown"
            refusal = Reason(ReasonCode.NO_CONTACT, text)
        elif not result.contact:
            refusal = _no_contact(result.seq)
        elif len(self._jobs) >= WAITING_MAX:
            refusal = Reason(ReasonCode.BUSY, f"{WAITING_MAX} presses are already waiting")
        else:
            # What an ADD took must not be added again when it comes to rest.
            self._rest.suppress()
            points = press_points(result.height, calibration.geometry)
            flange_T_sensor = from_seven(calibration.flange_T_sensor)
            add = partial(self._add, points, replace(frame, image=_NO_IMAGE), flange_T_sensor)
            self._jobs.put(add, replies.pop(0))
        for reply in replies:  # the same frame twice would be the same press twice
            reply(refusal or Reason(ReasonCode.BUSY, f"frame {result.seq} is already being added"))

    def _count_refusal(self, reply: Reply, outcome: SessionResult | Reason) -> None:
        if isinstance(outcome, Reason):
            with self._lock:
                self._counts["refused"] += 1
        reply(outcome)

    def _note_missed(self, outcome: SessionResult | Reason) -> None:
        """Take the outcome for a contact at rest, which nobody waits for."""
        reason = None
        if isinstance(outcome, Reason):
            _log.warning("did not add a settled contact: %s", outcome)
            reason = Reason(outcome.code, f"did not add the latest contact: {outcome}")
        with self._lock:
            self._missed_reason = reason
            self._missed += reason is not None
            self._counts["missed"] += reason is not None

    # The thread runs these.

    def _run(self) -> None:
        """Resume an open session, then do one job after another until `stop`."""
        self._resume()
        while True:
            try:
                job = self._jobs.next(DEFERRED_S if self._deferred else None)
            except TimeoutError:  # it is time to publish a deferred map
                if self._session is not None:
                    self._deferred = self.publish_map(self._session.map_revision())
                continue
            if job is None:
                break
            outcome: SessionResult | Reason
            try:
                outcome = job()
            except TacshadeError as error:
                outcome = error.reason
            # In this order: whoever gets the reply may act on the state at once.
            self._show_state()
            self._jobs.answer(outcome)
            if isinstance(outcome, SessionEnded | SessionAborted):
                # glibc keeps what lies below its newest block: of the 287 MB of a full map 200
                # stayed, which looked like a leak over sessions.
                return_free_memory()
        if self._session is not None:
            self._session.file.close()
        if self._folder_lock is not None:
            self._folder_lock.release()

    def _resume(self) -> None:
        try:
            with disk_errors(self._folder):
                if not self._folder.is_dir():  # the first session makes it
                    return
            self._own_folder()
            session = StitchSession.resume(self._folder, self._sensor_id)
        except TacshadeError as error:
            _log.warning("cannot resume the session: %s", error)
            return
        if session is None:
            return
        self._session = session
        self._show_state()
        if session.presses:
            self._deferred = self.publish_map(session.map_revision())
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
            session.file.remove()
            self._clear_session()
            return SessionAborted(session.name, session.presses)
        raise DeviceError(
            "the session has only just started; add the press again", code=ReasonCode.NO_SESSION
        )

    def _begin(self, name: str) -> SessionBegun:
        # Another daemon had the folder when this one started; it may have ended since, and have
        # left a session.
        if self._folder_lock is None:
            self._own_folder()
            self._resume()
        # Somebody deleted its folder: it cannot be ended, and must not stand in the way of the
        # next.
        if self._session is not None and self._session.file.gone:
            _log.warning(
                "deleted session %s with %d presses", self._session.name, self._session.presses
            )
            self._session.file.close()
            self._clear_session()
        if self._session is not None:
            text = f"session {self._session.name} is open; end or abort it first"
            raise DeviceError(text, code=ReasonCode.BUSY)
        if self._calibration is None:
            raise DeviceError("no frame has been reconstructed yet", code=ReasonCode.NO_FRAME)
        session = StitchSession.begin(self._folder, name, self._calibration, self._sensor_id)
        self._session, self._rest = session, RestDetector()
        with self._lock:
            self._missed, self._missed_reason = 0, None
        _log.info("started stitching session %s", session.name)
        return SessionBegun(session.name)

    def _add(self, points: PressPoints, frame: Frame, flange_T_sensor: Rigid) -> PressAdded:
        session, seq = self._session, frame.seq
        if session is None:
            raise DeviceError("the session has ended", code=ReasonCode.NO_SESSION)
        if len(points.points_mm) == 0:
            reason = _no_contact(seq)
            raise DeviceError(reason.text, code=reason.code)
        # This waits for the pose after the frame, which the reconstruct thread must not do.
        posed = self._robot.with_interpolated_pose(frame) if self._robot else frame
        if posed.pose is None:
            raise DeviceError(
                f"frame {seq}: the robot's pose at the frame's time is unknown",
                code=ReasonCode.NO_POSE,
            )
        added = session.add(points, of_pose(posed.pose) @ flange_T_sensor, seq)
        with self._lock:
            self._counts["presses"] += 1
        self._deferred = self.publish_map(session.map_revision())
        return added

    def _end(self, session: StitchSession) -> SessionEnded:
        if session.presses == 0:
            raise DeviceError(
                "the session has no presses; use ABORT to end it", code=ReasonCode.NO_PRESS
            )
        # `status/stitching` shows it: the map takes seconds, in which nothing else is answered.
        self._ending = True
        try:
            calibration = self._calibration
            suspected = None if calibration is None else session.suspected(calibration)
            if suspected is not None:
                _log.warning("session %s: the poses: %s", session.name, suspected)
            ended, final_map = session.finish(self._missed, suspected, self._jobs.check_wanted)
        finally:
            self._ending = False
        self._map_folder = str(session.folder)
        self._clear_session()
        self.publish_map(final_map)
        return ended

    def _clear_session(self) -> None:
        self._session = None
        self._deferred = False
        self._show_state()
        self._adds.refuse_all(Reason(ReasonCode.NO_SESSION, "the session has ended"))

    def _show_state(self) -> None:
        session = self._session
        known = (
            {key: getattr(session, key) for key in ("name", "presses", "points", "revision")}
            if session
            else {}
        )
        self._state = SessionState(**known, folder=self._map_folder)


def _no_contact(seq: int) -> Reason:
    return Reason(ReasonCode.NO_CONTACT, f"frame {seq}: nothing is touching the sensor")
