"""Encode typed results, reasons and events as the texts of ``OK``, ``ERR`` and ``EVT`` lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, assert_never

from tacshade_edge.protocol.results import (
    ClockRead,
    FrameCaptured,
    LineStatus,
    NoSession,
    PressAdded,
    ReferenceTaken,
    SerialResult,
    SessionAborted,
    SessionBegun,
    SessionEnded,
    SessionStatus,
    TouchSwitched,
)
from tacshade_edge.protocol.serial.line import LINE_BYTES_MAX
from tacshade_edge.protocol.serial.touch import TouchSeen, touch_text
from tacshade_edge.reasons import Reason, ReasonCode

PROTOCOL_VERSION: Final = 1
ERROR_WORDS: Final[dict[ReasonCode, str]] = {
    ReasonCode.UNKNOWN_VERB: "VERB",
    ReasonCode.BAD_ARGUMENTS: "ARGS",
    ReasonCode.BAD_CHECKSUM: "CRC",
    ReasonCode.BAD_SYNTAX: "SYNTAX",
    ReasonCode.OTHER_VERSION: "VERSION",
    ReasonCode.NUMBER_REUSED: "REUSED",
    ReasonCode.NUMBER_STALE: "STALE",
    ReasonCode.BUSY: "BUSY",
    ReasonCode.TIMEOUT: "TIMEOUT",
    ReasonCode.UNAVAILABLE: "UNAVAILABLE",
    ReasonCode.NOT_CALIBRATED: "UNCALIBRATED",
    ReasonCode.CONFIG: "FAILED",
    ReasonCode.DEVICE: "FAILED",
    ReasonCode.DECODE: "FAILED",
    ReasonCode.DISK: "FAILED",
    ReasonCode.IN_USE: "FAILED",
    ReasonCode.DISK_FULL: "FAILED",
    ReasonCode.FRAME_INVALID: "INVALID",
    ReasonCode.NO_SESSION: "NOSESSION",
    ReasonCode.BAD_NAME: "NAME",
    ReasonCode.NAME_TAKEN: "EXISTS",
    ReasonCode.NO_FRAME: "NOFRAME",
    ReasonCode.NO_CONTACT: "NOCONTACT",
    ReasonCode.NO_POSE: "NOPOSE",
    ReasonCode.MAP_FULL: "FULL",
    ReasonCode.NO_PRESS: "EMPTY",
}
"""The word of each code on the serial line, and at the beginning of an error of ``res/stitch``."""
_OTHERWISE: Final = "REFUSED"


@dataclass(frozen=True, slots=True)
class PortOpened:
    """The port was opened after an absence of `away_ms`, or 0."""

    away_ms: int


@dataclass(frozen=True, slots=True)
class PosesMissing:
    """Poses are missing, `poses` of them by their numbers."""

    poses: int


@dataclass(frozen=True, slots=True)
class SyncChanged:
    """The state of the robot's clock changed."""

    mode: str
    error_us: int


LinkEvent = PortOpened | PosesMissing | SyncChanged | TouchSeen


def result_text(result: SerialResult) -> str:
    """The text after ``OK seq``; docs/reference/serial.md describes each."""
    match result:
        case ClockRead():
            return f"{result.t2_ns} {result.t3_ns}"
        case FrameCaptured():
            text = (
                f"frame={result.frame} t_ns={result.t_ns} contact={int(result.contact)} depth_mm={result.depth_mm:.3f} "
                f"area_mm2={result.area_mm2:.1f} objects={result.objects}"
            )
            error_us = result.pose_error_us
            return f"{text} pose=0" if error_us is None else f"{text} pose=1 pose_error_us={error_us}"
        case LineStatus():
            return (
                f"camera={result.camera} fps={result.fps} sync={result.sync} error_us={result.error_us} "
                f"drift_ppm={result.drift_ppm} poses={result.poses} lost={result.poses_lost} "
                f"damaged={result.damaged} garbage={result.garbage}"
            )
        case TouchSwitched():
            return f"on=1 rate_hz={result.rate_hz}" if result.rate_hz else "on=0"
        case ReferenceTaken():
            crc32, noise_grey = result.calibration_crc32, result.noise_grey
            stored = int(result.unstored is None)
            return f"frames={result.frames} calibration_crc32={crc32} noise_grey={noise_grey} stored={stored}"
        case SessionBegun():
            return f"name={result.name}"
        case PressAdded():
            return f"press={result.press} frame={result.frame} points={result.points}"
        case SessionEnded():
            return (
                f"name={result.name} presses={result.presses} used={result.used} refined={int(result.refined)} "
                f"disagreement_mm={result.disagreement_mm:.3f} area_mm2={result.area_mm2:.0f}"
            )
        case SessionAborted():
            return f"name={result.name} presses={result.presses}"
        case SessionStatus():
            return (
                f"open=1 name={result.name} presses={result.presses} points={result.points} tiles={result.tiles} "
                f"revision={result.revision} missed={result.missed}"
            )
        case NoSession():
            return "open=0"
        case _:
            assert_never(result)


def error_word(code: ReasonCode) -> str:
    """The code's word on the line."""
    return ERROR_WORDS.get(code, _OTHERWISE)


def error_text(reason: Reason, verb: str = "") -> str:
    """The text after ``ERR seq``: the code's word and its text; for ``REFERENCE``, most reasons share one word."""
    refused = verb == "REFERENCE" and reason.code is not ReasonCode.NOT_CALIBRATED
    word = _OTHERWISE if refused else error_word(reason.code)
    return f"{word} {reason.text}"


def answer_text(seq: int | None, outcome: SerialResult | Reason, verb: str = "") -> str:
    """The line that answers the command `seq`."""
    if isinstance(outcome, Reason):
        return printable(f"ERR {seq_text(seq)} {error_text(outcome, verb)}")
    return printable(f"OK {seq_text(seq)} {result_text(outcome)}")


def event_text(event: LinkEvent) -> str:
    """The line that reports `event`."""
    match event:
        case PortOpened():
            away = f" away_ms={event.away_ms}" if event.away_ms else ""
            return f"EVT READY tacshade {PROTOCOL_VERSION}{away}"
        case PosesMissing():
            return f"EVT GAP poses={event.poses}"
        case SyncChanged():
            return f"EVT SYNC mode={event.mode} error_us={event.error_us}"
        case TouchSeen():
            return touch_text(event)
        case _:
            assert_never(event)


def seq_text(seq: int | None) -> str:
    """A command's number, or ``-`` if it has none."""
    return "-" if seq is None else str(seq)


def printable(text: str) -> str:
    """Convert `text` to printable ASCII and shorten it to fit on a line with its checksum."""
    return "".join(c if " " <= c <= "~" and c != "*" else "?" for c in text[: LINE_BYTES_MAX - 6])
