"""The results of commands, one type each. The encoders are `replies` and `serial.answers`."""

from __future__ import annotations

from dataclasses import dataclass

from tacshade_edge.reasons import Reason


@dataclass(frozen=True, slots=True)
class ProfileChosen:
    """Result of ``req/profile``: the profile now in use."""

    profile: str


@dataclass(frozen=True, slots=True)
class ReferenceTaken:
    """Result of ``req/reference`` and ``REFERENCE``: the mean of `frames` images, their RMS of g in grey levels.

    `unstored` is the reason why the reference will not survive a restart; None if it will.
    """

    frames: int
    calibration_crc32: int
    noise_grey: float
    unstored: Reason | None = None


@dataclass(frozen=True, slots=True)
class SessionBegun:
    """A stitching session is open."""

    name: str


@dataclass(frozen=True, slots=True)
class PressAdded:
    """A press has been stored on disk and added to the map.

    Attributes
    ----------
    press : int
        Its number in the session, from 1.
    frame : int
        The sequence number of its frame.
    points : int
    """

    press: int
    frame: int
    points: int


@dataclass(frozen=True, slots=True)
class SessionEnded:
    """The session ended and its final map is complete.

    Attributes
    ----------
    name : str
    presses, used : int
        Number of presses in the session, and in the map.
    refined : bool
        Whether the poses were refined rather than taken as exact.
    disagreement_mm : float
        RMS of the height changes that would make the presses agree.
    area_mm2 : float
        Area of the map's cells that have a height.
    """

    name: str
    presses: int
    used: int
    refined: bool
    disagreement_mm: float
    area_mm2: float


@dataclass(frozen=True, slots=True)
class SessionAborted:
    """The session was discarded with its presses."""

    name: str
    presses: int


@dataclass(frozen=True, slots=True)
class SessionStatus:
    """The open session; `missed` counts the contacts at rest that could not be added."""

    name: str
    presses: int
    points: int
    tiles: int
    revision: int
    missed: int


@dataclass(frozen=True, slots=True)
class NoSession:
    """The status while no session is open."""


SessionResult = SessionBegun | PressAdded | SessionEnded | SessionAborted | SessionStatus | NoSession
RequestResult = ProfileChosen | ReferenceTaken | SessionResult


@dataclass(frozen=True, slots=True)
class ClockRead:
    """Result of ``SYNC``: when it arrived and when this reply is sent, in ns of the daemon's clock."""

    t2_ns: int
    t3_ns: int


@dataclass(frozen=True, slots=True)
class FrameCaptured:
    """Result of ``CAPTURE``: one reconstruction. `pose_error_us` is None if the frame has no pose."""

    frame: int
    t_ns: int
    contact: bool
    depth_mm: float
    area_mm2: float
    objects: int
    pose_error_us: int | None


@dataclass(frozen=True, slots=True)
class LineStatus:
    """Result of ``STATUS``: the camera's state and rate in 1/s, the clock's accuracy, and the counts of the line."""

    camera: str
    fps: float
    sync: str
    error_us: int
    drift_ppm: float
    poses: int
    poses_lost: int
    damaged: int
    garbage: int


@dataclass(frozen=True, slots=True)
class TouchSwitched:
    """Result of ``TOUCH``: the greatest number of events per second; 0 is off."""

    rate_hz: int


SerialResult = ClockRead | FrameCaptured | LineStatus | TouchSwitched | ReferenceTaken | SessionResult
