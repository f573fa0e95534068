"""Makes the daemon's parts that depend on the settings.

Those that only some settings need are imported here when they are made: a board without a robot
spends neither memory nor time on them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacshade_edge.daemon.active_profile import ActiveProfile, Step
from tacshade_edge.daemon.live_recorder import LiveRecorder
from tacshade_edge.mqtt.link import MqttLink
from tacshade_edge.mqtt.publishing import Publisher
from tacshade_edge.pipeline.ledger import FrameLedger
from tacshade_edge.pipeline.observer import FrameObserver, Reply
from tacshade_edge.reasons import Reason
from tacshade_edge.rigid import from_seven
from tacshade_edge.robot.ports import make_serial_port
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import LADDER, PROFILES, profile_with
from tacshade_edge.settings import Settings
from tacshade_edge.types import Calibration
from tacshade_edge.wire.requests import Request

if TYPE_CHECKING:
    from tacshade_edge.daemon.hand_process import FingerLine
    from tacshade_edge.robot.robot import Robot, SharedLine
    from tacshade_edge.sensor.reconstruct import Reconstructor
    from tacshade_edge.stitching.session_worker import Sessions


def make_active(
    settings: Settings, known: Calibration | Reason, report: Callable[[Step], None]
) -> ActiveProfile:
    """The profile that the settings choose, with its reconstructor if there is a calibration."""
    # `auto` makes the rest of its ladder itself, and chooses by what it measures.
    name = settings.profile if settings.profile in PROFILES else LADDER[-1]
    profile = profile_with(name, settings.outline)
    first = known if isinstance(known, Reason) else make_reconstructor(known, profile)
    return ActiveProfile(
        first, settings.profile, settings.latency_budget_ms, settings.outline, report
    )


def make_robot(
    settings: Settings,
    on_request: Callable[[Request, Reply], None],
    status: Callable[[], dict[str, Any]],
    link: MqttLink,
    reconstructor: Callable[[], Reconstructor | Reason],
    line: SharedLine | None,
) -> Robot | None:
    """The robot, if the settings name its port or another sensor shares it."""
    follows = line is not None and line.hears is not None
    port = None if follows else make_serial_port(settings.serial)
    if not port and not follows:
        return None
    from tacshade_edge.robot.robot import Robot  # imports pyserial

    def missing() -> Reason | None:
        made = reconstructor()
        return made if isinstance(made, Reason) else None

    def quantities() -> Sequence[str] | Reason:
        made = reconstructor()
        return made if isinstance(made, Reason) else made.quantities

    publish = partial(link.set_retained, "status/serial")
    return Robot(port, on_request, status, publish, missing, quantities, line)


def make_sessions(settings: Settings, link: MqttLink, robot: Robot | None) -> Sessions | None:
    """The stitching sessions, if frames have poses."""
    if settings.serial is None and not settings.source.has_poses():
        return None
    from tacshade_edge.stitching.session_worker import Sessions

    folder = Path(settings.stitching.folder)
    return Sessions(folder, settings.sensor_id, link.set_retained, robot)


def make_recorder(
    settings: Settings, link: MqttLink, robot: Robot | None, written: Callable[[], None]
) -> LiveRecorder:
    """The recorder, whose frames have the robot's poses if there is one."""
    return LiveRecorder(
        partial(link.set_retained, "status/recorder"),
        written,
        robot.with_interpolated_pose if robot else lambda frame: frame,
        settings.recorder.pre_roll_s,
    )


def make_publisher(settings: Settings, link: MqttLink, ledger: FrameLedger) -> Publisher:
    """What publishes frames, and settles them in the ledger."""
    return Publisher(
        link.offer,
        link.publish_event,
        ledger.settle,
        link.has_listener,
        always_shear=settings.shear == "always",
    )


def make_reporter(settings: Settings, line: FingerLine | None) -> FrameObserver | None:
    """What reports to the hand's process, if the sensor is a finger of one."""
    if line is None or not settings.hand_T_sensor:
        return None
    from tacshade_edge.daemon.hand_process import FingerReporter

    return FingerReporter(line, from_seven(settings.hand_T_sensor))
