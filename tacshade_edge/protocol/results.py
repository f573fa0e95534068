"""What a command that was done gives: one typed value each. The encoders are `messages` and `serial.answers`."""

from __future__ import annotations

from dataclasses import dataclass

from tacshade_edge.reasons import Reason


@dataclass(frozen=True, slots=True)
class ProfileChosen:
    """Of ``req/profile``: the profile that is now used."""

    profile: str


@dataclass(frozen=True, slots=True)
class ReferenceTaken:
    """Of ``req/reference`` and ``REFERENCE``: the mean of `frames` images, RMS of g between them in grey levels.

    `unstored` is why it will not outlive a restart; None when it does.
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
    """A press is on the disk and in the map.

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
    """The final map is made.

    Attributes
    ----------
    name : str
    presses, used : int
        Those of the session, and those in the map.
    refined : bool
        The poses were not taken as exact.
    disagreement_mm : float
        RMS of how far presses would have to move in height to agree.
    area_mm2 : float
        Of the map's cells that have a height.
    """

    name: str
    presses: int
    used: int
    refined: bool
    disagreement_mm: float
    area_mm2: float


@dataclass(frozen=True, slots=True)
class SessionAborted:
    """The session was thrown away with its presses."""

    name: str
    presses: int


@dataclass(frozen=True, slots=True)
class SessionStatus:
    """The open session; `missed` are contacts at rest that could not be added."""

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
    """Of ``SYNC``: when it was received and when this reply is sent, in ns of the daemon's clock."""

    t2_ns: int
    t3_ns: int


@dataclass(frozen=True, slots=True)
class FrameCaptured:
    """Of ``CAPTURE``: one reconstruction. `pose_error_us` is None where the frame has no pose."""

    frame: int
    t_ns: int
    contact: bool
    depth_mm: float
    area_mm2: float
    objects: int
    pose_error_us: int | None


@dataclass(frozen=True, slots=True)
class LineStatus:
    """Of ``STATUS``: the camera's state and rate in 1/s, how well the clock is known, what came on the line."""

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
    """Of ``TOUCH``: at most how many events a second come now; 0 is off."""

    rate_hz: int


SerialResult = ClockRead | FrameCaptured | LineStatus | TouchSwitched | ReferenceTaken | SessionResult
