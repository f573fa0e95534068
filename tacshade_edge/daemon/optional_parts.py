"""The parts that a daemon has and imports only if the settings need them: robot, stitching sessions, hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from tacshade_edge.daemon.pipeline.observer import FrameObserver
from tacshade_edge.daemon.requests import Reply
from tacshade_edge.devices.mqtt.link import MqttLink
from tacshade_edge.factories import ports, sources
from tacshade_edge.protocol.requests import Request
from tacshade_edge.reasons import Reason
from tacshade_edge.rigid import from_seven
from tacshade_edge.settings import Settings
from tacshade_edge.types import Frame

if TYPE_CHECKING:
    from tacshade_edge.daemon.hand.finger_reporter import FingerReporter
    from tacshade_edge.daemon.hand.lines import FingerLine
    from tacshade_edge.daemon.robot.robot import Robot
    from tacshade_edge.daemon.robot.shared_line import SharedLine
    from tacshade_edge.daemon.stitching.session_requests import SessionRequests


@dataclass(frozen=True, slots=True)
class Siblings:
    """A sensor's lines to the other processes of its daemon: to its hand, and for a robot's line that they share."""

    hand: FingerLine | None = None
    robot: SharedLine | None = None


ALONE: Final = Siblings()


@dataclass(frozen=True, slots=True)
class OptionalParts:
    """The parts that a daemon's settings need.

    Attributes
    ----------
    before_publishing, after_publishing : tuple of FrameObserver
        Parts that see a frame before it is published, and parts that see it after.
    posed : callable or None
        Adds the pose that is known at once to a frame.
    interpolated : callable or None
        Adds the pose to a frame after waiting a moment for it.
    verbs : mapping of str to callable
        Carry out and answer the requests with these verbs.
    """

    before_publishing: tuple[FrameObserver, ...]
    after_publishing: tuple[FrameObserver, ...]
    posed: Callable[[Frame], Frame] | None
    interpolated: Callable[[Frame], Frame] | None
    verbs: Mapping[str, Callable[[Request], None]]


def make_optional_parts(
    settings: Settings,
    siblings: Siblings,
    link: MqttLink,
    reply: Reply,
    ask: Callable[[Request], None],
    status: Callable[[], dict[str, Any]],
    missing: Callable[[], Reason | None],
) -> OptionalParts:
    """Make the parts; for `reply`, `ask`, `status` and `missing` see `Robot` and `SessionRequests`."""
    robot: Robot | None = None
    sessions: SessionRequests | None = None
    finger: FingerReporter | None = None
    follows = siblings.robot is not None and siblings.robot.hears is not None
    port = None if follows else ports.make_serial_port(settings.serial)
    if port or follows:
        from tacshade_edge.daemon.robot.robot import Robot  # imports pyserial

        publish = partial(link.set_retained, "status/serial")
        robot = Robot(port, ask, status, publish, missing, siblings.robot)
    if sources.frames_have_poses(settings):
        from tacshade_edge.daemon.stitching.session_requests import SessionRequests

        folder = Path(settings.stitching.folder)
        sessions = SessionRequests(folder, settings.sensor_id, link.set_retained, reply, robot)
    if siblings.hand and settings.hand_T_sensor:
        from tacshade_edge.daemon.hand.finger_reporter import FingerReporter

        finger = FingerReporter(siblings.hand, from_seven(settings.hand_T_sensor))
    return OptionalParts(
        # Before, since a subscriber that sees a contact may begin a session.
        before_publishing=(sessions,) if sessions else (),
        after_publishing=tuple(part for part in (finger, robot) if part),
        posed=robot.with_pose if robot else None,
        interpolated=robot.with_interpolated_pose if robot else None,
        verbs={"stitch": sessions.handle} if sessions else {},
    )
