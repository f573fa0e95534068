"""The texts of answers and events: the words of docs/reference/serial.md, each from its value."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

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
from tacshade_edge.protocol.serial.answers import (
    ERROR_WORDS,
    PortOpened,
    PosesMissing,
    SyncChanged,
    answer_text,
    event_text,
)
from tacshade_edge.protocol.serial.touch import TouchSeen
from tacshade_edge.reasons import Reason, ReasonCode

DOCS = Path(__file__).parents[3] / "docs"


@pytest.mark.parametrize(
    ("result", "text"),
    [
        (ClockRead(5, 9), "5 9"),
        (
            FrameCaptured(812, 9, True, 1.23456, 20.06, 1, 250),
            "frame=812 t_ns=9 contact=1 depth_mm=1.235 area_mm2=20.1 objects=1 pose=1 pose_error_us=250",
        ),
        (
            FrameCaptured(812, 9, False, 0.0, 0, 0, None),
            "frame=812 t_ns=9 contact=0 depth_mm=0.000 area_mm2=0.0 objects=0 pose=0",
        ),
        (
            LineStatus("streaming", 30.0, "two-way", 500, 1.25, 100, 1, 2, 3),
            "camera=streaming fps=30.0 sync=two-way error_us=500 drift_ppm=1.25 poses=100 lost=1 damaged=2 garbage=3",
        ),
        (TouchSwitched(30), "on=1 rate_hz=30"),
        (TouchSwitched(0), "on=0"),
        (ReferenceTaken(10, 7, 0.5), "frames=10 calibration_crc32=7 noise_grey=0.5 stored=1"),
        (
            ReferenceTaken(10, 7, 0.5, Reason(ReasonCode.DISK, "full")),
            "frames=10 calibration_crc32=7 noise_grey=0.5 stored=0",
        ),
        (SessionBegun("pad-1"), "name=pad-1"),
        (PressAdded(3, 812, 1290), "press=3 frame=812 points=1290"),
        (
            SessionStatus("pad-1", 3, 3871, 4, 3, 0),
            "open=1 name=pad-1 presses=3 points=3871 tiles=4 revision=3 missed=0",
        ),
        (NoSession(), "open=0"),
        (
            SessionEnded("pad-1", 3, 3, False, 0.0312, 211.6),
            "name=pad-1 presses=3 used=3 refined=0 disagreement_mm=0.031 area_mm2=212",
        ),
        (SessionAborted("pad-1", 3), "name=pad-1 presses=3"),
    ],
)
def test_what_follows_ok(result: SerialResult, text: str) -> None:
    assert answer_text(7, result) == f"OK 7 {text}"
    assert answer_text(None, result) == f"OK - {text}"


def test_every_word_of_the_documents_has_a_code() -> None:
    serial, stitching = ((DOCS / name).read_text() for name in ("reference/serial.md", "how-to/stitching.md"))
    answers = stitching[stitching.index("| answer | when |") :]
    words = {word for row in re.findall(r"^\| (`[A-Z].*?) \|", answers, re.MULTILINE) for word in row.split("`")[1::2]}
    words |= set(re.findall(r"ERR seq ([A-Z]+)", serial)) - {"REFUSED"}
    assert len(words) > 10
    assert words <= set(ERROR_WORDS.values())


def test_a_reference_is_refused_with_one_word() -> None:
    busy = Reason(ReasonCode.BUSY, "already taking a reference")
    assert answer_text(7, busy, "CAPTURE") == "ERR 7 BUSY already taking a reference"
    assert answer_text(7, busy, "REFERENCE") == "ERR 7 REFUSED already taking a reference"
    other = Reason(ReasonCode.FRAME_IN_CONTACT, "shows contact")
    assert answer_text(7, other) == "ERR 7 REFUSED shows contact"


def test_events() -> None:
    assert event_text(PortOpened(0)) == "EVT READY tacshade 1"
    assert event_text(PortOpened(17)) == "EVT READY tacshade 1 away_ms=17"
    assert event_text(PosesMissing(3)) == "EVT GAP poses=3"
    assert event_text(SyncChanged("oneway", 2000)) == "EVT SYNC mode=oneway error_us=2000"
    assert event_text(TouchSeen(1, 2, True, (("x_mm", None),))) == "EVT TOUCH 1 2 x_mm=-"
