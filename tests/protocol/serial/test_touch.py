"""What a robot asks of touches, what a line carries, and the event, against the literal vectors."""

from __future__ import annotations

import json
import math
from itertools import combinations, product
from pathlib import Path
from typing import Any

import pytest

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.serial import cobs
from tacshade_edge.protocol.serial.line import LINE_BYTES_MAX, seal
from tacshade_edge.protocol.serial.touch import (
    NAMES_MAX,
    TouchAsked,
    TouchSeen,
    event_bytes_max,
    parse_touch,
    too_slow,
    touch_text,
)
from tacshade_edge.types import QUANTITIES

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "serial.json").read_text())
LONGEST = tuple(sorted(QUANTITIES, key=len)[-NAMES_MAX:])


@pytest.mark.parametrize("vector", VECTORS["touches"], ids=lambda v: str(v["seq"]))
def test_event(vector: dict[str, Any]) -> None:
    seen = TouchSeen(vector["seq"], vector["t_ns"], vector["contact"], tuple(vector["values"].items()))
    line = seal(touch_text(seen))
    assert line.decode() == vector["line"] + "\n"
    assert (cobs.encode(b"L" + line[:-1]) + b"\0").hex() == vector["frame"]


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
    assert touch_text(TouchSeen(1, 2, True, (("x_mm", value),))) == f"EVT TOUCH 1 2 x_mm={text}"


def test_no_event_is_longer_than_what_is_reckoned_with_and_than_a_line() -> None:
    for count in (1, NAMES_MAX):
        for names, value in product(combinations(QUANTITIES, count), (-1000.0001, None)):
            seen = TouchSeen(2**32 - 1, 2**63 - 1, value is not None, tuple((name, value) for name in names))
            frame = cobs.encode(b"L" + seal(touch_text(seen))[:-1]) + b"\0"
            assert len(frame) <= event_bytes_max(names) <= event_bytes_max(LONGEST) <= LINE_BYTES_MAX


@pytest.mark.parametrize(
    ("args", "asked"),
    [
        ("OFF", None),
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
        ("OFF depth_mm", "found 'OFF depth_mm', expected ON or OFF"),
        ("depth_mm", "found 'depth_mm', expected ON or OFF"),
        ("ON", "found 0 names, expected 1 to 6 different names"),
        ("ON 30", "found 0 names, expected 1 to 6 different names"),
        (f"ON {' '.join(QUANTITIES[:7])}", "found 7 names, expected 1 to 6 different names"),
        ("ON depth_mm depth_mm", "found 2 names, expected 1 to 6 different names"),
        ("ON Depth_mm", "found 'Depth_mm', expected one of depth_mm tilt_x_deg"),
        ("ON 30 depth_mm", "found '30', expected one of depth_mm"),
        ("ON depth_mm 0", "found the RATE 0, expected a whole number of Hz from 1 to 1000"),
        ("ON depth_mm 1001", "found the RATE 1001, expected a whole number of Hz from 1 to 1000"),
        ("ON depth_mm 29.97", "found the RATE 29.97, expected a whole number of Hz from 1 to 1000"),
        ("ON depth_mm -5", "found '-5', expected one of"),
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
        "found 10440 bytes/s (60 events/s of up to 174 bytes), expected at most 864 bytes/s (90 % of 9600 baud); "
        "use a RATE of at most 4, fewer names or a faster line"
    )
    assert too_slow(TouchAsked(LONGEST, 4), 9600) is None
    assert too_slow(TouchAsked(LONGEST, 5), 9600) is not None
    slowest = too_slow(TouchAsked(LONGEST, 1), 110)
    assert slowest is not None
    assert slowest.text.endswith("90 % of 110 baud); use fewer names or a faster line")
