"""Stitching sessions: BEGIN, ADD, END, ABORT and STATUS, from the serial line, MQTT or a replay.

Everything that touches a session runs in one thread, `stitch`: the map, the disk, the end that takes seconds. The
reconstruct thread only looks whether a frame is wanted, and hands its points over.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Literal

import numpy as np

from tacshade_edge.core.stitching.press_points import Touch, touch_points
from tacshade_edge.core.stitching.rest import Settled
from tacshade_edge.core.stitching.stitcher import Stitcher
from tacshade_edge.core.stitching.surface_map import Raster
from tacshade_edge.devices.files.map_files import write_map
from tacshade_edge.devices.files.stitch_file import About, StitchFile, open_session
from tacshade_edge.devices.files.whole_files import told
from tacshade_edge.errors import TacshadeError
from tacshade_edge.rigid import Rigid, from_seven, of_pose
from tacshade_edge.types import Calibration, Frame, Reconstruction

_log = logging.getLogger(__name__)

ADD_TIMEOUT_NS = 5_000_000_000
WAITING_MAX = 16
RETELL_S = 0.25
_NAME_MAX = 64
_NO_IMAGE = np.zeros((0, 0), np.uint8)

Answer = Callable[[str, str], None]
"""``answer(code, text)``, once; `code` is empty when it was done."""


@dataclass(frozen=True, slots=True)
class MapRevision:
    """What is told of a map.

    Attributes
    ----------
    name : str
        The session's.
    revision : int
        Counts the presses and the end.
    presses, used : int
    calibration_crc32 : int
        That the session began with.
    folder : str
        Where the final map's files are; empty before the end.
    raster : callable
        Makes the map; its cost grows with the map, so call it no more often than needed, before `told` returns.
    """

    name: str
    revision: int
    presses: int
    used: int
    calibration_crc32: int
    folder: str
    raster: Callable[[], Raster]


@dataclass(frozen=True, slots=True)
class Session:
    """How the stitching is, at one instant.

    Attributes
    ----------
    name : str
        Of the open session; empty: none is.
    ending : bool
        Its map is being made, which takes seconds.
    presses, points, revision : int
    missed : int
        Settled contacts that could not be added to the latest session, since the daemon started.
    reason : str
        Why the latest one could not; empty once another could.
    folder : str
        Files of the latest map that ended; empty before.
    """

    name: str = ""
    ending: bool = False
    presses: int = 0
    points: int = 0
    revision: int = 0
    missed: int = 0
    reason: str = ""
    folder: str = ""


@dataclass(frozen=True, slots=True)
class _Command:
    action: str
    name: str
    answer: Answer


@dataclass(frozen=True, slots=True)
class _Add:
    touch: Touch
    frame: Frame  # without its image
    flange_T_sensor: Rigid
    answer: Answer


@dataclass(frozen=True, slots=True)
class _WaitingAdd:
    since_ns: int
    answer: Answer


class Stitching:
    """One sensor's sessions.

    Parameters
    ----------
    folder : Path
        Sessions lie below it, each in its own folder. One that was open when the daemon died goes on.
    told : callable
        ``told(revision)`` after each press and at the end, in this object's thread; True: it was held back, and is to
        be told again in a moment, as it is then.
    posed : callable
        Gives a frame its pose; called in this object's thread, which it may keep waiting for a moment.
    automatic : bool
        Every contact that settles while a session is open is added.

    """

    def __init__(
        self,
        folder: Path,
        told: Callable[[MapRevision], bool | None],
        posed: Callable[[Frame], Frame] = lambda frame: frame,
        *,
        automatic: bool = True,
    ) -> None:
        self._folder = folder
        self._told = told
        self._posed = posed
        self._automatic = automatic
        self._jobs: SimpleQueue[_Command | _Add | Literal["stop"]] = SimpleQueue()
        self._waiting: deque[_WaitingAdd] = deque()
        self._lock = threading.Lock()
        self._settled = Settled()
        self._calibration: Calibration | None = None
        self._file: StitchFile | None = None
        self._stitcher: Stitcher | None = None
        self._revision = 0
        self._counts = {"presses": 0, "refused": 0, "missed": 0}
        self._missed, self._missed_reason = 0, ""
        self._ended = ""
        self._held = False
        self._now = Session()  # of the thread; the others read it

    @property
    def now(self) -> Session:
        """As any thread may see it."""
        with self._lock:
            return replace(self._now, missed=self._missed, reason=self._missed_reason)

    @property
    def open(self) -> bool:
        """Whether a session is open: every frame is then reconstructed in whole."""
        return bool(self._now.name)

    def as_dict(self) -> dict[str, int]:
        """For ``health``: presses that were added, refused commands to add one, settled contacts that were missed."""
        with self._lock:
            return {**self._counts, "waiting": len(self._waiting) + self._jobs.qsize()}

    # What other threads call: nothing here waits.

    def stitch(self, action: str, name: str, answer: Answer) -> None:
        """Do ``BEGIN``, ``ADD``, ``END``, ``ABORT`` or ``STATUS``; the answer comes later, from any thread."""
        if action == "ADD":
            answer = self._counted(answer)
        if action == "ADD" and self.open:
            with self._lock:
                busy = len(self._waiting) >= WAITING_MAX
                if not busy:
                    self._waiting.append(_WaitingAdd(time.monotonic_ns(), answer))
            if busy:
                answer("BUSY", f"{WAITING_MAX} presses are waiting for a frame")
        elif self._jobs.qsize() >= WAITING_MAX:
            answer("BUSY", f"{WAITING_MAX} commands are waiting")
        else:
            self._jobs.put(_Command(action, name, answer))

    def reconstructed(self, frame: Frame, result: Reconstruction, calibration: Calibration) -> None:
        """A frame was: adds it where it was asked for, or where its contact has settled."""
        self._calibration = calibration
        if not self.open:
            return
        settled = self._settled.of(result.t_ns, result.valid and result.contact, result.depth_max_mm)
        with self._lock:
            ready = [w for w in self._waiting if w.since_ns <= frame.t_ns]
            for waiting in ready:
                self._waiting.remove(waiting)
        answers = [w.answer for w in ready] or ([self._settled_answer] if settled and self._automatic else [])
        if not answers:
            return
        refusal = _refusal(result)
        if refusal is None and self._jobs.qsize() >= WAITING_MAX:
            refusal = "BUSY", f"{WAITING_MAX} presses are being added"
        if refusal is not None:
            for answer in answers:
                answer(*refusal)
            return
        self._settled.taken()
        touch = touch_points(result.height, calibration.geometry)
        flange_T_sensor = from_seven(calibration.flange_T_sensor)
        # The same frame twice would be the same press twice.
        self._jobs.put(_Add(touch, replace(frame, image=_NO_IMAGE), flange_T_sensor, answers[0]))
        for answer in answers[1:]:
            answer("BUSY", f"frame {result.seq} is being added already")

    def poll(self) -> None:
        """Refuse what waits for a frame in vain; called now and then."""
        now_ns = time.monotonic_ns()
        with self._lock:
            late = [w for w in self._waiting if now_ns - w.since_ns > ADD_TIMEOUT_NS]
            for waiting in late:
                self._waiting.remove(waiting)
        for waiting in late:
            waiting.answer("TIMEOUT", f"no frame within {ADD_TIMEOUT_NS / 1e9:.0f} s")

    def stop(self) -> None:
        """Make `run` return after the jobs that wait; an open session stays open on the disk."""
        self._jobs.put("stop")

    def _counted(self, answer: Answer) -> Answer:
        """Of a command to add a press."""

        def counted(code: str, text: str) -> None:
            if code:
                with self._lock:
                    self._counts["refused"] += 1
            answer(code, text)

        return counted

    def _settled_answer(self, code: str, text: str) -> None:
        """For a press that no one asked for."""
        if code:
            _log.warning("a settled contact was not added: %s", text)
        with self._lock:
            self._missed_reason = f"the latest contact was not added: {text}" if code else ""
            if code:
                self._missed += 1
                self._counts["missed"] += 1

    # The thread.

    def run(self) -> None:
        """Go on with an open session, then do one job after another until `stop`."""
        self._resume()
        while (job := self._next()) != "stop":
            if job is None:
                if self._file is not None and self._stitcher is not None:
                    self._tell(self._growing(self._file, self._stitcher))
                continue
            try:
                code, text = "", self._add(job) if isinstance(job, _Add) else self._do(job)
            except _RefusedError as refused:
                code, text = refused.code, str(refused)
            except TacshadeError as error:
                code, text = "FAILED", str(error)
            self._now = self._session()
            job.answer(code, text)
        if self._file is not None:
            self._file.close()

    def _next(self) -> _Command | _Add | Literal["stop"] | None:
        """The next job; None when it is time to tell again of the map."""
        try:
            return self._jobs.get(timeout=RETELL_S if self._held else None)
        except Empty:
            return None

    def _tell(self, revision: MapRevision) -> None:
        self._held = bool(self._told(revision))

    def _resume(self) -> None:
        try:
            with told(self._folder):
                path = open_session(self._folder)
            if path is None:
                return
            self._file, presses = StitchFile.resume(path)
        except TacshadeError as error:
            _log.warning("session not resumed: %s", error)
            return
        self._stitcher = Stitcher(self._file.about.skin_radius_mm)
        for touch, pose in presses:
            with contextlib.suppress(ValueError):  # refused when it came, too
                self._stitcher.add(touch, pose)
        self._revision = self._stitcher.presses
        self._now = self._session()
        if self._stitcher.presses:
            self._tell(self._growing(self._file, self._stitcher))
        _log.info("session %s goes on with %d presses", self._file.about.name, self._stitcher.presses)

    def _do(self, command: _Command) -> str:
        if command.action == "BEGIN":
            return self._begin(command.name)
        if command.action == "STATUS":
            return self._status()
        if self._file is None or self._stitcher is None:
            raise _RefusedError("NOSESSION", "no session is open, begin one first")
        if command.action == "END":
            return self._end(self._file, self._stitcher)
        if command.action == "ABORT":
            return self._abort(self._file, self._stitcher)
        raise _RefusedError("NOSESSION", "the session has just begun, add again")

    def _begin(self, name: str) -> str:
        if self._file is not None:
            raise _RefusedError("BUSY", f"session {self._file.about.name} is open, end or abort it first")
        if self._calibration is None:
            raise _RefusedError("NOFRAME", "no frame was reconstructed yet")
        name = name or time.strftime("%Y%m%d-%H%M%S", time.gmtime())
        if (
            len(name) > _NAME_MAX
            or name.startswith(".")
            or not all((c.isascii() and c.isalnum()) or c in "._-" for c in name)
        ):
            raise _RefusedError("NAME", f"found {name[:80]!r}, expected letters, digits, . _ -, at most {_NAME_MAX}")
        with told(self._folder):
            there = (self._folder / name).exists()
        if there:
            raise _RefusedError("EXISTS", f"{self._folder / name} is there already")
        about = About(name, time.time_ns(), self._calibration.crc32, self._calibration.geometry.skin_radius_mm)
        self._file = StitchFile.create(self._folder / name, about)
        self._stitcher, self._revision, self._settled = Stitcher(about.skin_radius_mm), 0, Settled()
        with self._lock:
            self._missed, self._missed_reason = 0, ""
        self._now = self._session()
        _log.info("stitching session %s begins", name)
        return f"name={name}"

    def _add(self, add: _Add) -> str:
        if self._file is None or self._stitcher is None:
            raise _RefusedError("NOSESSION", "the session has ended")
        seq, count = add.frame.seq, len(add.touch.points_mm)
        if count == 0:
            raise _RefusedError("NOCONTACT", f"frame {seq}: nothing touches")
        if (pose := self._posed(add.frame).pose) is None:
            raise _RefusedError("NOPOSE", f"frame {seq}: the robot's pose is not known at its time")
        base_T_sensor = of_pose(pose) @ add.flange_T_sensor
        # On the disk first: what is acknowledged is there. A press that the map refuses is refused again on resuming.
        self._file.append(add.touch, base_T_sensor)
        try:
            self._stitcher.add(add.touch, base_T_sensor)
        except ValueError as error:
            raise _RefusedError("FULL", str(error)) from None
        self._revision += 1
        with self._lock:
            self._counts["presses"] += 1
        self._tell(self._growing(self._file, self._stitcher))
        return f"press={self._stitcher.presses} frame={seq} points={count}"

    def _growing(self, file: StitchFile, stitcher: Stitcher) -> MapRevision:
        about, presses = file.about, stitcher.presses
        return MapRevision(
            about.name, self._revision, presses, presses, about.calibration_crc32, "", stitcher.map.raster
        )

    def _end(self, file: StitchFile, stitcher: Stitcher) -> str:
        if stitcher.presses == 0:
            raise _RefusedError("EMPTY", "no press was added; ABORT ends the session")
        self._now = replace(self._session(), ending=True)
        finished = stitcher.finish()
        rejected = [k + 1 for k, press in enumerate(finished.presses) if press.rejected]
        used = stitcher.presses - len(rejected)
        self._revision += 1
        final = MapRevision(
            file.about.name,
            self._revision,
            stitcher.presses,
            used,
            file.about.calibration_crc32,
            str(file.folder),
            lambda: finished.raster,
        )
        area_mm2 = float(np.count_nonzero(np.isfinite(finished.raster.z_mm))) * finished.raster.step_mm**2
        described: dict[str, Any] = {
            "name": file.about.name,
            "revision": self._revision,
            "presses": stitcher.presses,
            "used": used,
            "rejected": rejected,
            "missed": self._missed,
            "refined": finished.refined,
            "disagreement_mm": round(finished.disagreement_mm, 4),
            "calibration_crc32": file.about.calibration_crc32,
        }
        write_map(file.folder, finished.raster, described)
        file.end()
        self._ended = str(file.folder)
        self._closed()
        self._tell(final)
        return (
            f"name={file.about.name} presses={final.presses} used={used} refined={int(finished.refined)} "
            f"disagreement_mm={finished.disagreement_mm:.3f} area_mm2={area_mm2:.0f}"
        )

    def _abort(self, file: StitchFile, stitcher: Stitcher) -> str:
        file.remove()
        self._closed()
        return f"name={file.about.name} presses={stitcher.presses}"

    def _closed(self) -> None:
        self._file = self._stitcher = None
        self._held = False
        self._now = self._session()
        with self._lock:
            waiting, self._waiting = list(self._waiting), deque()
        for one in waiting:
            one.answer("NOSESSION", "the session has ended")

    def _session(self) -> Session:
        if self._file is None or self._stitcher is None:
            return Session(folder=self._ended)
        stitcher = self._stitcher
        name, presses, points = self._file.about.name, stitcher.presses, stitcher.points
        return Session(name, presses=presses, points=points, revision=self._revision, folder=self._ended)

    def _status(self) -> str:
        if self._file is None or self._stitcher is None:
            return "open=0"
        stitcher = self._stitcher
        return (
            f"open=1 name={self._file.about.name} presses={stitcher.presses} points={stitcher.points} "
            f"tiles={stitcher.map.tiles} revision={self._revision} missed={self._missed}"
        )


class _RefusedError(Exception):
    """A command that cannot be done now."""

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.code = code


def _refusal(result: Reconstruction) -> tuple[str, str] | None:
    if not result.valid:
        return "INVALID", f"frame {result.seq}: {result.reason}"
    if not result.contact:
        return "NOCONTACT", f"frame {result.seq}: nothing touches"
    return None
