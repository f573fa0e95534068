"""Requests: strict, and refused in one line."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol import replies, requests
from tacshade_edge.protocol.requests import PlaybackCommand, Request
from tacshade_edge.reasons import Reason, ReasonCode


@pytest.mark.parametrize(
    ("verb", "payload", "expected"),
    [
        ("reference", b'{"transaction": "a-1"}', Request("reference", "a-1")),
        ("profile", b'{"profile": "fast", "transaction": 7}', Request("profile", 7, "fast")),
        ("status", b"", Request("status")),
        ("record", b'{"action": "start", "seconds": 5}', Request("record", action="start", seconds=5.0)),
        (
            "record",
            b'{"action": "start", "seconds": 5, "format": "mcap"}',
            Request("record", action="start", seconds=5.0, format="mcap"),
        ),
        (
            "record",
            b'{"action": "start", "name": "a.b-1", "seconds": 0.5, "transaction": 1}',
            Request("record", 1, action="start", name="a.b-1", seconds=0.5),
        ),
        ("record", b'{"action": "stop"}', Request("record", action="stop")),
        ("record", b'{"action": "mark", "text": "now"}', Request("record", action="mark", text="now")),
        ("replay", b'{"back": true}', Request("replay", playback=PlaybackCommand(back=True))),
        ("replay", b'{"step": true, "seek_s": 2}', Request("replay", playback=PlaybackCommand(step=True, seek_s=2.0))),
        ("stitch", b'{"action": "begin", "name": "pad-1"}', Request("stitch", action="begin", name="pad-1")),
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


def test_request_keeps_where_an_mqtt5_reply_goes() -> None:
    request = requests.parse_request("status", b"{}", response_topic="me/in", correlation=b"\0\xff")
    assert (request.response_topic, request.correlation) == ("me/in", b"\0\xff")


@pytest.mark.parametrize(
    ("verb", "payload", "told"),
    [
        ("reboot", b"{}", "expected one of reference, profile, status, record, stitch, replay"),
        ("replay", b'{"speed": 0}', ">= 0.01"),
        ("record", b'{"action": "mark", "seconds": 1}', "unknown field `seconds`"),
        ("profile", b"{}", "missing required field `profile`"),
        ("profile", b'{"profile": ""}', "length >= 1"),
        ("profile", b'{"profile": 3}', "got `int`"),
        ("record", b"{}", "missing required field `action`"),
        ("record", b'{"action": "pause"}', "Invalid value 'pause'"),
        ("record", b'{"action": "start"}', "missing required field `seconds`"),
        ("record", b'{"action": "start", "seconds": 0}', "> 0"),
        ("record", b'{"action": "start", "seconds": 3601}', "<= 3600"),
        ("record", b'{"action": "start", "seconds": 1, "format": "avi"}', "format"),
        ("record", b'{"action": "start", "seconds": 1, "name": ""}', "matching regex"),
        ("record", b'{"action": "start", "seconds": 1, "name": ".."}', "matching regex"),
        ("record", b'{"action": "start", "seconds": 1, "name": "a/b"}', "matching regex"),
        ("record", b'{"action": "start", "seconds": 1, "name": "a\\n"}', "matching regex"),
        ("record", b'{"action": "stop", "seconds": 1}', "unknown field `seconds`"),
        ("stitch", b"{}", "missing required field `action`"),
        ("stitch", b'{"action": "start"}', "expected a JSON object"),
        ("stitch", b'{"action": "end", "name": "a"}', "found a name with the action end"),
        ("stitch", b'{"action": "begin", "name": ""}', "matching regex"),
        ("stitch", b'{"action": "begin", "name": ".pad"}', "matching regex"),
        ("stitch", b'{"action": "begin", "name": "%s"}' % (b"x" * 65), "up to 64 letters"),
        ("status", b'{"transactoin": 1}', "unknown field `transactoin`"),
        ("status", b'{"transaction": 1.5}', "got `float`"),
        ("status", b'{"transaction": true}', "got `bool`"),
        ("status", b'{"transaction": 99999999999999999999999}', "9007199254740992"),
        ("status", b"[]", "got `array`"),
        ("status", b"{", "truncated"),
        ("status", b"\xff\xfe", "malformed"),
        ("status", b'{"transaction": "\xff"}', "expected a JSON object"),
        ("status", b'{"a":' + b"[" * 4000, "expected a JSON object"),
        ("status", b" " * 4097, "at most 4096"),
    ],
)
def test_bad_request_says_what_and_what_was_expected(verb: str, payload: bytes, told: str) -> None:
    with pytest.raises(DecodeError) as caught:
        requests.parse_request(verb, payload)
    assert told in str(caught.value)


@given(st.text(), st.binary() | st.recursive(st.none() | st.text(), st.lists).map(lambda v: json.dumps(v).encode()))
def test_no_request_does_worse_than_a_one_line_decode_error(verb: str, payload: bytes) -> None:
    for tried in (verb, "profile"):
        with pytest.raises(DecodeError) as caught:
            requests.parse_request(tried, b'{"x": ' + payload + b"}")
        assert str(caught.value).isprintable()
    echo = requests.parse_transaction(payload)
    assert json.loads(replies.encode_error(echo, Reason(ReasonCode.BUSY, "why")))["transaction"] == echo


def test_refused_request_still_tells_its_transaction() -> None:
    assert requests.parse_transaction(b'{"transaction": "t", "unknown": [1]}') == "t"
    assert requests.parse_transaction(b'{"transaction": [1]}') is None
    assert requests.parse_transaction(b'{"a":' + b"[" * 4000) is None
