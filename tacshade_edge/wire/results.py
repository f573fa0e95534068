"""The results of commands, one type each, with the figures that ``res/<verb>``
and the robot's line report.
"""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec.structs import asdict

from tacshade_edge.reasons import Reason


class CommandResult(msgspec.Struct, frozen=True):
    """What a command found or did."""

    def figures(self) -> dict[str, Any]:
        """The values by name, in order, rounded as both sides report them."""
        return asdict(self)


class ProfileChosen(CommandResult, frozen=True):
    """Result of ``req/profile``: the profile now in use."""

    profile: str


class ReferenceTaken(CommandResult, frozen=True):
    """Result of ``req/reference`` and ``REFERENCE``:
    the mean of `frames` images, their RMS of g in grey levels.
    """

    frames: int
    calibration_crc32: int
    noise_grey: float
    unstored: Reason | None = None  # why the reference will not survive a restart

    def figures(self) -> dict[str, Any]:
        found = asdict(self)
        # Programs ask whether it is stored; the reply has the reason in fields of its own.
        stored = found.pop("unstored") is None
        return {**found, "stored": stored}


class SessionBegun(CommandResult, frozen=True):
    """A stitching session is open."""

    name: str


class PressAdded(CommandResult, frozen=True):
    """The frame numbered `frame` has been stored on disk and added to the map as a press,
    numbered from 1.
    """

    press: int
    frame: int
    points: int


class SessionEnded(CommandResult, frozen=True):
    """The session ended, and `used` of its presses are in its final map.

    `suspected`: what the poses are suspected of, as a word, and `unit` the unit that they seem to
    be in; each empty without one.
    """

    name: str
    presses: int
    used: int
    refined: bool  # whether the poses were refined rather than taken as exact
    disagreement_mm: float  # RMS of the height changes that would make the presses agree
    area_mm2: float  # of the map's cells that have a height
    suspected: str = ""
    unit: str = ""

    def figures(self) -> dict[str, Any]:
        rounded = {
            "disagreement_mm": round(self.disagreement_mm, 3),
            "area_mm2": round(self.area_mm2),
        }
        found = {**asdict(self), "refined": int(self.refined), **rounded}
        return {key: value for key, value in found.items() if value != ""}


class SessionAborted(CommandResult, frozen=True):
    """The session was discarded with its presses."""

    name: str
    presses: int


class SessionStatus(CommandResult, frozen=True):
    """The open session; `missed` counts the contacts at rest that could not be added."""

    name: str
    presses: int
    points: int
    tiles: int
    revision: int
    missed: int

    def figures(self) -> dict[str, Any]:
        return {"open": 1, **asdict(self)}


class NoSession(CommandResult, frozen=True):
    """The status while no session is open."""

    def figures(self) -> dict[str, Any]:
        return {"open": 0}


SessionResult = (
    SessionBegun | PressAdded | SessionEnded | SessionAborted | SessionStatus | NoSession
)
RequestResult = ProfileChosen | ReferenceTaken | SessionResult


class ClockRead(CommandResult, frozen=True):
    """Result of ``SYNC``: when it arrived and when this reply is sent,
    in ns of the daemon's clock.
    """

    t2_ns: int
    t3_ns: int


class FrameCaptured(CommandResult, frozen=True):
    """Result of ``CAPTURE``: one reconstruction.

    `pose_error_us` is None if the frame has no pose; depth and area are None if the frame is
    `touched`: something touches, but its depth is unknown.
    """

    frame: int
    t_ns: int
    contact: bool
    depth_mm: float | None
    area_mm2: float | None
    objects: int
    pose_error_us: int | None
    touched: bool = False

    def figures(self) -> dict[str, Any]:
        found = {
            **asdict(self),
            "area_mm2": None if self.area_mm2 is None else round(float(self.area_mm2), 1),
            "pose": self.pose_error_us is not None,
        }
        error_us, touched = found.pop("pose_error_us"), found.pop("touched")
        return (
            found
            | ({} if error_us is None else {"pose_error_us": error_us})
            | ({"touched": True} if touched else {})
        )


class LineStatus(CommandResult, frozen=True):
    """Result of ``STATUS``: the camera's state and rate in 1/s, the clock's accuracy,
    and the counts of the line.
    """

    camera: str
    fps: float
    sync: str
    error_us: int
    drift_ppm: float
    poses: int
    lost: int
    damaged: int
    garbage: int


class TouchSwitched(CommandResult, frozen=True):
    """Result of ``TOUCH``: the greatest number of events per second; 0 is off."""

    rate_hz: int

    def figures(self) -> dict[str, Any]:
        return {"on": 1, "rate_hz": self.rate_hz} if self.rate_hz else {"on": 0}
