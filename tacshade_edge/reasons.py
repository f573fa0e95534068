"""Reasons for failures: a code for programs, from one enumeration, and a text for people.

Programs decide by the code alone, so the wording of a text may change at any time.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class ReasonCode(StrEnum):
    """Every reason in ``summary.json``, MQTT messages and serial lines;
    docs/reference/mqtt/reasons.md lists them.
    """

    # A frame.
    SIZE = "size"
    NO_DISC = "no_disc"
    SATURATED = "saturated"
    BLACK = "black"
    NO_CONTRAST = "no_contrast"
    NOISE = "noise"
    LIGHT = "light"
    TORN = "torn"
    SURROUND = "surround"
    GLARE = "glare"
    LIGHT_DRIFT = "light_drift"
    CAMERA_SHIFT = "camera_shift"
    UNTRUSTED = "untrusted"
    TOUCH_UNMEASURED = "touch_unmeasured"
    TIP_MOVING = "tip_moving"
    NO_USABLE_FRAME = "no_usable_frame"
    # A touch.
    TOUCH_UNLIKE = "touch_unlike"
    TOUCH_RANGE = "touch_range"
    TOUCH_NETWORKS = "touch_networks"
    # A daemon without a calibration.
    NOT_CALIBRATED = "not_calibrated"
    # An error without a more specific code below.
    CONFIG = "config"
    DEVICE = "device"
    DECODE = "decode"
    # A camera, a serial port, the broker.
    STARTING = "starting"
    ABSENT = "absent"
    WRONG_KIND = "wrong_kind"
    PERMISSION = "permission"
    IN_USE = "in_use"
    NOT_OFFERED = "not_offered"
    UNREACHABLE = "unreachable"
    REFUSED = "refused"
    MESSAGE_SIZE_LIMIT = "message_size_limit"
    NO_ANSWER = "no_answer"
    LOST = "lost"
    STALLED = "stalled"
    REPLAY = "replay"
    # A recording and its end.
    NO_RECORDING = "no_recording"
    TIME = "time"
    STOPPED = "stopped"
    SOURCE_ENDED = "source_ended"
    DAEMON_STOPPED = "daemon_stopped"
    CALIBRATION_CHANGED = "calibration_changed"
    RECORDING_FULL = "recording_full"
    DISK = "disk"
    DISK_FULL = "disk_full"
    # A step of the profile `auto`, and a reload.
    OVER_BUDGET = "over_budget"
    WITHIN_BUDGET = "within_budget"
    RESTART = "restart"
    # A command, over MQTT or on the serial line.
    BAD_REQUEST = "bad_request"
    UNKNOWN_PROFILE = "unknown_profile"
    BUSY = "busy"
    TIMEOUT = "timeout"
    UNAVAILABLE = "unavailable"
    FRAME_INVALID = "frame_invalid"
    FRAME_IN_CONTACT = "frame_in_contact"
    REFERENCE_INVALID = "reference_invalid"
    PATCH_CHANGED = "patch_changed"
    # A line of the robot.
    NOT_A_LINE = "not_a_line"
    UNKNOWN_VERB = "unknown_verb"
    BAD_ARGUMENTS = "bad_arguments"
    BAD_CHECKSUM = "bad_checksum"
    BAD_SYNTAX = "bad_syntax"
    OTHER_VERSION = "other_version"
    NUMBER_REUSED = "number_reused"
    NUMBER_STALE = "number_stale"
    LINE_TOO_SLOW = "line_too_slow"
    # A stitching session and its presses.
    NO_SESSION = "no_session"
    BAD_NAME = "bad_name"
    NAME_TAKEN = "name_taken"
    NO_FRAME = "no_frame"
    NO_CONTACT = "no_contact"
    NO_POSE = "no_pose"
    MAP_FULL = "map_full"
    NO_PRESS = "no_press"
    PRESS_DEVIATES = "press_deviates"
    PRESS_DISPLACED = "press_displaced"
    # The robot's line and its clock.
    PORT_LATENCY = "port_latency"
    NOTHING_RECEIVED = "nothing_received"
    ROBOT_RESTARTED = "robot_restarted"
    CLOCK_JUMPED = "clock_jumped"
    CLOCK_WENT_BACK = "clock_went_back"
    CLOCK_LATE = "clock_late"
    CLOCK_DRIFT = "clock_drift"
    CLOCK_UNIT = "clock_unit"
    CLOCK_STANDS = "clock_stands"
    POSE_UNIT = "pose_unit"


@dataclass(frozen=True, slots=True)
class Reason:
    """One failure's code and text. `text`: one line."""

    code: ReasonCode
    text: str

    def __str__(self) -> str:
        return self.text


def text_of(reason: Reason | None) -> str:
    """The text of `reason`; empty if there is no reason."""
    return "" if reason is None else reason.text


def code_of(reason: Reason | None) -> str:
    """The code of `reason`; empty if there is no reason."""
    return "" if reason is None else reason.code.value


def reason_fields(reason: Reason | None, key: str = "reason") -> dict[str, str]:
    """The fields of a message for a reason: ``{"reason": text, "reason_code":
    code}``, both empty without one.
    """
    return {key: text_of(reason), f"{key}_code": code_of(reason)}
