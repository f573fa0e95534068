"""What a robot asks, and the texts of answers and events with the words of
docs/reference/serial.md.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from tacshade_edge.errors import DecodeError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.framing import cobs_encode
from tacshade_edge.robot.line import LINE_BYTES_MAX, seal
from tacshade_edge.robot.verbs import (
    NAMES_MAX,
    TouchAsked,
    TouchSeen,
    answer_text,
    event_bytes_max,
    object_text,
    parse_touch,
    ready_text,
    too_slow,
)
from tacshade_edge.types import QUANTITIES
from tacshade_edge.wire.results import (
    ClockRead,
    CommandResult,
    FrameCaptured,
    LineStatus,
    NoSession,
    PressAdded,
    ReferenceTaken,
    SessionAborted,
    SessionBegun,
    SessionEnded,
    SessionStatus,
    TouchSwitched,
)

VECTORS = json.loads((Path(__file__).parents[1] / "wire" / "vectors" / "serial.json").read_text())
LONGEST = tuple(sorted(QUANTITIES, key=len)[-NAMES_MAX:])


@pytest.mark.parametrize(
    ("result", "text"),
    [
        (ClockRead(5, 9), "5 9"),
        (
            FrameCaptured(812, 9, True, 1.23456, 20.06, 1, 250),
            (
                "frame=812 t_ns=9 contact=1 depth_mm=1.235 area_mm2=20.1 objects=1 pose=1 "
                "pose_error_us=250"
            ),
        ),
        (
            FrameCaptured(812, 9, False, 0.0, 0, 0, None),
            "frame=812 t_ns=9 contact=0 depth_mm=0.000 area_mm2=0.0 objects=0 pose=0",
        ),
        (
            FrameCaptured(812, 9, False, None, None, 0, None, touched=True),
            "frame=812 t_ns=9 contact=0 depth_mm=- area_mm2=- objects=0 pose=0 touched=1",
        ),
        (
            LineStatus("streaming", 30.0, "two-way", 500, 1.25, 100, 1, 2, 3),
            (
                "camera=streaming fps=30.0 sync=two-way error_us=500 drift_ppm=1.25 poses=100 "
                "lost=1 damaged=2 garbage=3"
            ),
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
def test_what_follows_ok(result: CommandResult, text: str) -> None:
    assert answer_text(7, result) == f"OK 7 {text}"
    assert answer_text(None, result) == f"OK - {text}"


def test_a_reference_is_refused_with_one_word() -> None:
    busy = Reason(ReasonCode.BUSY, "already taking a reference")
    assert answer_text(7, busy, "CAPTURE") == "ERR 7 BUSY already taking a reference"
    assert answer_text(7, busy, "REFERENCE") == "ERR 7 REFUSED already taking a reference"
    other = Reason(ReasonCode.FRAME_IN_CONTACT, "shows contact")
    assert answer_text(7, other) == "ERR 7 REFUSED shows contact"


def test_a_port_that_was_opened() -> None:
    assert ready_text(0) == "READY tacshade 1"
    assert ready_text(17) == "READY tacshade 1 away_ms=17"


@pytest.mark.parametrize("vector", VECTORS["touches"], ids=lambda v: str(v["seq"]))
def test_event(vector: dict[str, Any]) -> None:
    seen = TouchSeen(
        vector["seq"],
        vector["t_ns"],
        vector["contact"],
        tuple(vector["values"].items()),
        vector.get("touched", False),
    )
    line = seal(f"EVT {seen.text()}")
    assert line.decode() == vector["line"] + "\n"
    assert (cobs_encode(b"L" + line[:-1]) + b"\0").hex() == vector["frame"]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (-0.00049, "-0.000"),
        (999.9996, "1000.000"),
        (-999.9996, "-1000.0"),
        (99999.94, "99999.9"),
        (-1e7, "-"),
        (math.nan, "-"),
        (-math.inf, "-"),
        (None, "-"),
    ],
)
def test_a_value_has_at_most_eight_characters(value: float | None, text: str) -> None:
    assert TouchSeen(1, 2, True, (("x_mm", value),)).text() == f"TOUCH 1 2 x_mm={text}"


@pytest.mark.parametrize(
    ("args", "asked"),
    [
        ("off", None),
        ("ON depth_mm", TouchAsked(("depth_mm",), 60)),
        ("on force_z_n depth_mm 1", TouchAsked(("force_z_n", "depth_mm"), 1)),
        (f"ON {' '.join(QUANTITIES[:6])} 1000", TouchAsked(QUANTITIES[:6], 1000)),
    ],
)
def test_asked(args: str, asked: TouchAsked | None) -> None:
    assert parse_touch(args.split()) == asked


@pytest.mark.parametrize(
    ("args", "why"),
    [
        ("", "found '', expected ON or OFF"),
        ("depth_mm", "found 'depth_mm', expected ON or OFF"),
        ("ON", "found 0 names, expected 1 to 6 different names"),
        (f"ON {' '.join(QUANTITIES[:7])}", "found 7 names, expected 1 to 6 different names"),
        ("ON depth_mm depth_mm", "found 2 names, expected 1 to 6 different names"),
        ("ON 30 depth_mm", "found '30', expected one of depth_mm"),
        ("ON depth_mm 0", "found the RATE 0, expected a whole number of Hz from 1 to 1000"),
        ("ON depth_mm 29.97", "found the RATE 29.97, expected a whole number of Hz from 1 to 1000"),
    ],
)
def test_asked_wrongly(args: str, why: str) -> None:
    with pytest.raises(DecodeError) as error:
        parse_touch(args.split())
    assert str(error.value).startswith(why)


def test_a_line_that_cannot_carry_the_events_refuses_with_the_rate_that_it_can() -> None:
    assert too_slow(TouchAsked(QUANTITIES[:6], 60), 115200) is None  # what is known without labels
    refused = too_slow(TouchAsked(LONGEST, 60), 9600)
    assert refused is not None
    assert refused.text == (
        "found 10440 bytes/s (60 events/s of up to 174 bytes), expected at most 864 bytes/s (90 % "
        "of 9600 baud); use a lower RATE, fewer names or a faster line"
    )
    seen = TouchSeen(2**32 - 1, 2**63 - 1, True, tuple((name, -1000.0001) for name in LONGEST))
    longest = cobs_encode(b"L" + seal(f"EVT {seen.text()}")[:-1]) + b"\0"
    assert len(longest) <= event_bytes_max(LONGEST) <= LINE_BYTES_MAX
    assert too_slow(TouchAsked(LONGEST, 4), 9600) is None
    assert too_slow(TouchAsked(LONGEST, 5), 9600) is not None


@pytest.mark.parametrize("seq", [2**32, 10 * 365 * 86_400 * 60])
def test_a_frame_has_a_number_of_32_bits(seq: int) -> None:
    names = tuple((name, -1000.0001) for name in LONGEST)
    seen = TouchSeen(seq, 2**63 - 1, False, names)
    assert seen.text().split()[1] == str(seq % 2**32)
    assert object_text(seq, 5, "cup", 1.0) == f"OBJECT {seq % 2**32} 5 cup 1.000"
    for figures in (FrameCaptured(seq, 5, False, None, None, 0, None), PressAdded(3, seq, 7)):
        assert f" frame={seq % 2**32} " in f"{answer_text(1, figures)} "
