"""The results of commands, one type each, with the figures that ``res/<verb>`` and the robot's line report."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from tacshade_edge.reasons import Reason


class _Result:
    __slots__ = ()

    def figures(self) -> dict[str, Any]:
        """The values by name, in order, rounded as both sides report them."""
        return asdict(self)  # type: ignore[call-overload, no-any-return]


@dataclass(frozen=True, slots=True)
class ProfileChosen(_Result):
    """Result of ``req/profile``: the profile now in use."""

    profile: str


@dataclass(frozen=True, slots=True)
class ReferenceTaken(_Result):
    """Result of ``req/reference`` and ``REFERENCE``: the mean of `frames` images, their RMS of g in grey levels.

    `unstored` is the reason why the reference will not survive a restart; None if it will.
    """

    frames: int
    calibration_crc32: int
    noise_grey: float
    unstored: Reason | None = None

    def figures(self) -> dict[str, Any]:
        known = {"frames": self.frames, "calibration_crc32": self.calibration_crc32, "noise_grey": self.noise_grey}
        return {**known, "stored": self.unstored is None}


@dataclass(frozen=True, slots=True)
class SessionBegun(_Result):
    """A stitching session is open."""

    name: str


@dataclass(frozen=True, slots=True)
class PressAdded(_Result):
    """The frame numbered `frame` has been stored on disk and added to the map as a press, numbered from 1."""

    press: int
    frame: int
    points: int


@dataclass(frozen=True, slots=True)
class SessionEnded(_Result):
    """The session ended, and `used` of its presses are in its final map.

    `refined` states whether the poses were refined rather than taken as exact, `disagreement_mm` is the RMS of the
    height changes that would make the presses agree, `area_mm2` the area of the map's cells that have a height.
    """

    name: str
    presses: int
    used: int
    refined: bool
    disagreement_mm: float
    area_mm2: float

    def figures(self) -> dict[str, Any]:
        rounded = {"disagreement_mm": round(self.disagreement_mm, 3), "area_mm2": round(self.area_mm2)}
        return {**asdict(self), "refined": int(self.refined), **rounded}


@dataclass(frozen=True, slots=True)
class SessionAborted(_Result):
    """The session was discarded with its presses."""

    name: str
    presses: int


@dataclass(frozen=True, slots=True)
class SessionStatus(_Result):
    """The open session; `missed` counts the contacts at rest that could not be added."""

    name: str
    presses: int
    points: int
    tiles: int
    revision: int
    missed: int

    def figures(self) -> dict[str, Any]:
        return {"open": 1, **asdict(self)}


@dataclass(frozen=True, slots=True)
class NoSession(_Result):
    """The status while no session is open."""

    def figures(self) -> dict[str, Any]:
        return {"open": 0}


SessionResult = SessionBegun | PressAdded | SessionEnded | SessionAborted | SessionStatus | NoSession
RequestResult = ProfileChosen | ReferenceTaken | SessionResult


@dataclass(frozen=True, slots=True)
class ClockRead(_Result):
    """Result of ``SYNC``: when it arrived and when this reply is sent, in ns of the daemon's clock."""

    t2_ns: int
    t3_ns: int


@dataclass(frozen=True, slots=True)
class FrameCaptured(_Result):
    """Result of ``CAPTURE``: one reconstruction. `pose_error_us` is None if the frame has no pose."""

    frame: int
    t_ns: int
    contact: bool
    depth_mm: float
    area_mm2: float
    objects: int
    pose_error_us: int | None

    def figures(self) -> dict[str, Any]:
        found = {**asdict(self), "area_mm2": round(float(self.area_mm2), 1), "pose": self.pose_error_us is not None}
        error_us = found.pop("pose_error_us")
        return found if error_us is None else {**found, "pose_error_us": error_us}


@dataclass(frozen=True, slots=True)
class LineStatus(_Result):
    """Result of ``STATUS``: the camera's state and rate in 1/s, the clock's accuracy, and the counts of the line."""

    camera: str
    fps: float
    sync: str
    error_us: int
    drift_ppm: float
    poses: int
    lost: int
    damaged: int
    garbage: int


@dataclass(frozen=True, slots=True)
class TouchSwitched(_Result):
    """Result of ``TOUCH``: the greatest number of events per second; 0 is off."""

    rate_hz: int

    def figures(self) -> dict[str, Any]:
        return {"on": 1, "rate_hz": self.rate_hz} if self.rate_hz else {"on": 0}


SerialResult = ClockRead | FrameCaptured | LineStatus | TouchSwitched | ReferenceTaken | SessionResult
