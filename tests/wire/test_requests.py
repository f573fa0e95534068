"""Requests: strict, and refused in one line; the results
of replies have the serial line's words.
"""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.errors import DecodeError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.verbs import answer_text
from tacshade_edge.wire import requests
from tacshade_edge.wire.requests import PlaybackCommand, Request, encode_error, encode_reply
from tacshade_edge.wire.results import (
    ProfileChosen,
    ReferenceTaken,
    RequestResult,
    SessionBegun,
    SessionEnded,
)


@pytest.mark.parametrize(
    ("verb", "payload", "expected"),
    [
        ("reference", b'{"transaction": "a-1"}', Request("reference", "a-1")),
        ("profile", b'{"profile": "fast", "transaction": 7}', Request("profile", 7, "fast")),
        ("status", b"", Request("status")),
        (
            "record",
            b'{"action": "start", "seconds": 5}',
            Request("record", action="start", seconds=5.0),
        ),
        (
            "record",
            b'{"action": "start", "name": "a.b-1", "seconds": 0.5, "transaction": 1}',
            Request("record", 1, action="start", name="a.b-1", seconds=0.5),
        ),
        ("record", b'{"action": "stop"}', Request("record", action="stop")),
        (
            "record",
            b'{"action": "mark", "text": "now"}',
            Request("record", action="mark", text="now"),
        ),
        ("replay", b'{"back": true}', Request("replay", playback=PlaybackCommand(back=True))),
        (
            "replay",
            b'{"step": true, "seek_s": 2}',
            Request("replay", playback=PlaybackCommand(step=True, seek_s=2.0)),
        ),
        (
            "stitch",
            b'{"action": "begin", "name": "pad-1"}',
            Request("stitch", action="begin", name="pad-1"),
        ),
        (
            "stitch",
            b'{"action": "begin", "name": "%s"}' % (b"x" * 64),
            Request("stitch", action="begin", name="x" * 64),
        ),
        ("stitch", b'{"action": "add", "transaction": 2}', Request("stitch", 2, action="add")),
        ("status", b" {} ", Request("status")),
        ("status", b'{"transaction": null}', Request("status")),
    ],
)
def test_request(verb: str, payload: bytes, expected: Request) -> None:
    assert requests.parse_request(verb, payload) == expected


@pytest.mark.parametrize(
    ("verb", "payload", "expected"),
    [
        ("reboot", b"{}", "expected one of reference, profile, status, record, stitch, replay"),
        ("replay", b'{"speed": 0}', ">= 0.01"),
        ("record", b'{"action": "mark", "seconds": 1}', "unknown field `seconds`"),
        ("profile", b"{}", "missing required field `profile`"),
        ("profile", b'{"profile": ""}', "length >= 1"),
        ("record", b'{"action": "pause"}', "Invalid value 'pause'"),
        ("record", b'{"action": "start"}', "missing required field `seconds`"),
        ("record", b'{"action": "start", "seconds": 3601}', "<= 3600"),
        ("record", b'{"action": "start", "seconds": 1, "format": "mcap"}', "format"),
        ("record", b'{"action": "start", "seconds": 1, "name": ".."}', "matching regex"),
        ("record", b'{"action": "start", "seconds": 1, "name": "a/b"}', "matching regex"),
        ("record", b'{"action": "start", "seconds": 1, "name": "a\\n"}', "matching regex"),
        ("record", b'{"action": "stop", "seconds": 1}', "unknown field `seconds`"),
        ("stitch", b'{"action": "start"}', "expected the keys in docs/reference/mqtt.md"),
        ("stitch", b'{"action": "end", "name": "a"}', "found a name with the action end"),
        ("stitch", b'{"action": "begin", "name": ".pad"}', "matching regex"),
        ("stitch", b'{"action": "begin", "name": "%s"}' % (b"x" * 65), "matching regex"),
        ("status", b'{"transactoin": 1}', "unknown field `transactoin`"),
        ("status", b'{"transaction": true}', "got `bool`"),
        ("status", b'{"transaction": 99999999999999999999999}', "9007199254740992"),
        ("status", b"[]", "got `array`"),
        ("status", b"{", "truncated"),
        ("status", b"\xff\xfe", "malformed"),
        ("status", b'{"transaction": "\xff"}', "expected the keys"),
        ("status", b'{"a":' + b"[" * 4000, "expected the keys"),
        ("status", b" " * 4097, "at most 4096"),
    ],
)
def test_bad_request_says_what_and_what_was_expected(
    verb: str, payload: bytes, expected: str
) -> None:
    with pytest.raises(DecodeError) as caught:
        requests.parse_request(verb, payload)
    assert expected in str(caught.value)


@given(
    st.text(),
    st.binary()
    | st.recursive(st.none() | st.text(), st.lists).map(lambda v: json.dumps(v).encode()),
)
def test_no_request_does_worse_than_a_one_line_decode_error(verb: str, payload: bytes) -> None:
    for tried in (verb, "profile"):
        with pytest.raises(DecodeError) as caught:
            requests.parse_request(tried, b'{"x": ' + payload + b"}")
        assert str(caught.value).isprintable()
    echo = requests.parse_transaction(payload)
    assert json.loads(encode_error(echo, Reason(ReasonCode.BUSY, "why")))["transaction"] == echo


def test_replies_echo_the_transaction() -> None:
    done: Any = json.loads(encode_reply(Request("profile", "t"), {"profile": "fast"}))
    assert done == {"transaction": "t", "ok": True, "result": {"profile": "fast"}}
    refused = json.loads(encode_error(None, Reason(ReasonCode.UNKNOWN_PROFILE, "no such profile")))
    assert refused == {
        "transaction": None,
        "ok": False,
        "error": "no such profile",
        "reason_code": "unknown_profile",
    }


_TAKEN = {"frames": 10, "calibration_crc32": 7, "noise_grey": 0.5}


@pytest.mark.parametrize(
    ("result", "written"),
    [
        (SessionBegun("007"), {"name": "007"}),
        (
            SessionEnded("pad", 3, 2, False, 0.03149, 211.6),
            {
                "name": "pad",
                "presses": 3,
                "used": 2,
                "refined": 0,
                "disagreement_mm": 0.031,
                "area_mm2": 212,
            },
        ),
        (
            SessionEnded("pad", 3, 3, True, 0.5, 9.0, "poses_unit", "m"),
            {
                "name": "pad",
                "presses": 3,
                "used": 3,
                "refined": 1,
                "disagreement_mm": 0.5,
                "area_mm2": 9,
                "suspected": "poses_unit",
                "unit": "m",
            },
        ),
        (ProfileChosen("fast"), {"profile": "fast"}),
        (ReferenceTaken(10, 7, 0.5), {**_TAKEN, "stored": True, "reason": "", "reason_code": ""}),
        (
            ReferenceTaken(10, 7, 0.5, Reason(ReasonCode.DISK, "no space")),
            {**_TAKEN, "stored": False, "reason": "no space", "reason_code": "disk"},
        ),
    ],
)
def test_results_have_the_serial_lines_words_as_keys(
    result: RequestResult, written: dict[str, Any]
) -> None:
    payload = encode_reply(Request("status"), result)
    assert json.loads(payload)["result"] == written
    assert [*json.loads(payload)["result"]] == [*written]  # in that order
    if not isinstance(result, ProfileChosen):
        words = dict(word.split("=") for word in answer_text(1, result).split()[2:])
        without = {
            key: value for key, value in written.items() if not key.startswith("reason")
        }  # a line is short
        assert {
            key: value if key in ("name", "suspected", "unit") else float(value)
            for key, value in words.items()
        } == without


def test_the_error_of_stitch_begins_with_the_serial_lines_word() -> None:
    reason = Reason(
        ReasonCode.NO_POSE, "frame 812: the robot's pose at the frame's time is unknown"
    )
    error = json.loads(encode_reply(Request("stitch", 5, action="add"), reason))
    assert (error["transaction"], error["error"], error["reason_code"]) == (
        5,
        f"NOPOSE: {reason}",
        "no_pose",
    )
    error = json.loads(encode_reply(Request("reference"), reason))
    assert error["error"] == reason.text
