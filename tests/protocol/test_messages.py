"""JSON payloads: exact keys, strict requests, replies that echo."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol import messages
from tacshade_edge.protocol.messages import PlaybackCommand, Request
from tacshade_edge.protocol.results import (
    NoSession,
    PressAdded,
    ProfileChosen,
    ReferenceTaken,
    RequestResult,
    SessionAborted,
    SessionBegun,
    SessionEnded,
    SessionStatus,
)
from tacshade_edge.protocol.serial.answers import result_text
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Calibration, Disc, Geometry, Reconstruction, Slip, TouchedObject


def test_contact_is_flat_numbers_with_the_promised_keys(
    make_result: Callable[..., Reconstruction], two_objects: tuple[TouchedObject, ...]
) -> None:
    result = make_result(objects=two_objects, volume_mm3=np.float64(3.5))
    assert json.loads(messages.encode_contact(result, fps=59.5)) == {
        "t_ns": 1_000,
        "seq": 5,
        "contact": 1,
        "depth_max_mm": 1.75,
        "area_mm2": 10.0,
        "volume_mm3": 3.5,
        "objects": 2,
        "x_mm": 1.25,
        "y_mm": -2.5,
        "shear_x_mm": None,
        "shear_y_mm": None,
        "twist_deg": None,
        "slip": None,
        "slip_mm_s": None,
        "fps": 59.5,
        "reason_code": "",
        "degraded_code": "",
        "wall_ns": 2_000,
    }


def test_contact_without_contact_has_no_place(make_result: Callable[..., Reconstruction]) -> None:
    decoded = json.loads(messages.encode_contact(make_result(contact=False), fps=0.0))
    assert ",".join(decoded) == (
        "t_ns,seq,contact,depth_max_mm,area_mm2,volume_mm3,objects,x_mm,y_mm,"
        "shear_x_mm,shear_y_mm,twist_deg,slip,slip_mm_s,fps,reason_code,degraded_code,wall_ns"
    )
    assert [decoded[k] for k in ("contact", "depth_max_mm", "objects", "x_mm", "y_mm")] == [0, 0.0, 0, None, None]


def test_contact_tells_the_most_of_what_moves(
    make_result: Callable[..., Reconstruction], two_objects: tuple[TouchedObject, ...]
) -> None:
    one = replace(two_objects[0], shear_mm=(0.5, -0.5), twist_deg=3.0, slip=Slip.PARTIAL, slip_mm_s=0.5)
    other = replace(two_objects[1], shear_mm=(-2.0, 0.25), twist_deg=-4.0, slip=Slip.FULL, slip_mm_s=6.0)
    decoded = json.loads(messages.encode_contact(make_result(objects=(one, other)), fps=1.0))
    told = [decoded[k] for k in ("shear_x_mm", "shear_y_mm", "twist_deg", "slip", "slip_mm_s")]
    assert told == [-2.0, 0.25, -4.0, 2, 6.0]


def test_contact_has_the_codes_of_its_reasons(make_result: Callable[..., Reconstruction]) -> None:
    torn, glare = Reason(ReasonCode.TORN, "two frames"), Reason(ReasonCode.GLARE, "a spot")
    refused = json.loads(messages.encode_contact(make_result(valid=False, contact=False, reason=torn), fps=0.0))
    assert (refused["reason_code"], refused["degraded_code"]) == ("torn", "")
    doubtful = json.loads(messages.encode_contact(make_result(degraded=glare), fps=0.0))
    assert (doubtful["reason_code"], doubtful["degraded_code"]) == ("", "glare")


def test_nan_is_null_as_json_has_none(make_result: Callable[..., Reconstruction]) -> None:
    assert json.loads(messages.encode_contact(make_result(volume_mm3=math.nan), fps=math.inf))["volume_mm3"] is None


def test_info_places_a_pixel_in_mm() -> None:
    calibration = Calibration(
        geometry=Geometry(20.0, None, 30.0, Disc(239.5, np.float64(319.5), 200.0)),  # type: ignore[arg-type]
        polarity="bright",
        binarisation="adaptive",
        image_height_px=480,
        image_width_px=640,
        pitch_px=20.0,
        reference_white=np.zeros((480, 640), np.uint8),
        reference_grey=np.zeros((480, 640), np.uint8),
        noise_grey=1.0,
        alpha=15.0,
        crc32=0xDEADBEEF,
    )
    told = messages.encode_info(
        version="1", config_digest="ab", profile="fast", calibration=calibration, profiles=("fast", "paper")
    )
    info = json.loads(told)
    assert info["reference"] is None
    assert (info["hand_id"], info["hand_T_sensor"]) == (None, None)
    assert {k: info[k] for k in ("version", "wire_version", "config_digest", "profile", "profiles", "choice")} == {
        "version": "1",
        "wire_version": 1,
        "config_digest": "ab",
        "profile": "fast",
        "profiles": ["fast", "paper"],
        "choice": "fast",
    }
    geometry = info["geometry"]
    assert geometry["camera_distance_mm"] is None
    assert geometry["mm_per_px"] == pytest.approx(0.05)
    assert (geometry["row_c"], geometry["col_c"], geometry["radius_px"]) == (239.5, 319.5, 200.0)
    assert (geometry["skin_radius_mm"], geometry["visible_half_angle_deg"], geometry["f_px"]) == (20.0, 30.0, 0.0)
    assert geometry["calibration_crc32"] == 0xDEADBEEF
    assert geometry["flange_T_sensor"] == [0, 0, 0, 1, 0, 0, 0]


def test_status_and_health() -> None:
    absent = Reason(ReasonCode.ABSENT, "no such device")
    status = messages.encode_status("failed", absent, {"rate_hz": 60.0, "state": "details do not win"})
    expected = {"rate_hz": 60.0, "state": "failed", "reason": "no such device", "reason_code": "absent"}
    assert json.loads(status) == expected
    assert json.loads(messages.encode_status("idle")) == {"state": "idle", "reason": "", "reason_code": ""}
    assert json.loads(messages.encode_health({"captured": np.int64(3), "p99_ms": np.float32(1.5)})) == {
        "captured": 3,
        "p99_ms": 1.5,
    }
    with pytest.raises(TypeError):
        messages.encode_health({"captured": object()})


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
        ("stitch", b'{"action": "add", "transaction": 2}', Request("stitch", 2, action="add")),
        ("status", b" {} ", Request("status")),
        ("status", b'{"transaction": null}', Request("status")),
    ],
)
def test_request(verb: str, payload: bytes, expected: Request) -> None:
    assert messages.parse_request(verb, payload) == expected


def test_request_keeps_where_an_mqtt5_reply_goes() -> None:
    request = messages.parse_request("status", b"{}", response_topic="me/in", correlation=b"\0\xff")
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
        ("stitch", b'{"action": "begin", "name": ""}', "length >= 1"),
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
        messages.parse_request(verb, payload)
    assert told in str(caught.value)


@given(st.text(), st.binary() | st.recursive(st.none() | st.text(), st.lists).map(lambda v: json.dumps(v).encode()))
def test_no_request_does_worse_than_a_one_line_decode_error(verb: str, payload: bytes) -> None:
    for tried in (verb, "profile"):
        with pytest.raises(DecodeError) as caught:
            messages.parse_request(tried, b'{"x": ' + payload + b"}")
        assert str(caught.value).isprintable()
    echo = messages.parse_transaction(payload)
    assert json.loads(messages.encode_error(echo, Reason(ReasonCode.BUSY, "why")))["transaction"] == echo


def test_refused_request_still_tells_its_transaction() -> None:
    assert messages.parse_transaction(b'{"transaction": "t", "unknown": [1]}') == "t"
    assert messages.parse_transaction(b'{"transaction": [1]}') is None
    assert messages.parse_transaction(b'{"a":' + b"[" * 4000) is None


def test_replies_echo_the_transaction() -> None:
    done: Any = json.loads(messages.encode_result("t", {"profile": "fast"}))
    assert done == {"transaction": "t", "ok": True, "result": {"profile": "fast"}}
    refused = json.loads(messages.encode_error(None, Reason(ReasonCode.UNKNOWN_PROFILE, "no such profile")))
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
        (PressAdded(3, 812, 1290), {"press": 3, "frame": 812, "points": 1290}),
        (
            SessionEnded("pad", 3, 2, False, 0.03149, 211.6),
            {"name": "pad", "presses": 3, "used": 2, "refined": 0, "disagreement_mm": 0.031, "area_mm2": 212},
        ),
        (SessionAborted("pad", 3), {"name": "pad", "presses": 3}),
        (
            SessionStatus("pad", 3, 3871, 4, 3, 0),
            {"open": 1, "name": "pad", "presses": 3, "points": 3871, "tiles": 4, "revision": 3, "missed": 0},
        ),
        (NoSession(), {"open": 0}),
        (ProfileChosen("fast"), {"profile": "fast"}),
        (ReferenceTaken(10, 7, 0.5), {**_TAKEN, "stored": True, "reason": "", "reason_code": ""}),
        (
            ReferenceTaken(10, 7, 0.5, Reason(ReasonCode.DISK, "no space")),
            {**_TAKEN, "stored": False, "reason": "no space", "reason_code": "disk"},
        ),
    ],
)
def test_results_have_the_serial_lines_words_as_keys(result: RequestResult, written: dict[str, Any]) -> None:
    payload = messages.encode_result(None, result)
    assert json.loads(payload)["result"] == written
    assert [*json.loads(payload)["result"]] == [*written]  # in that order
    if not isinstance(result, ProfileChosen):
        words = dict(word.split("=") for word in result_text(result).split())
        without = {key: value for key, value in written.items() if not key.startswith("reason")}  # a line is short
        assert {key: value if key == "name" else float(value) for key, value in words.items()} == without


def test_the_error_of_stitch_begins_with_the_serial_lines_word() -> None:
    reason = Reason(ReasonCode.NO_POSE, "frame 812: the robot's pose is not known at its time")
    error = json.loads(messages.encode_reply(Request("stitch", 5, action="add"), reason))
    assert (error["transaction"], error["error"], error["reason_code"]) == (5, f"NOPOSE: {reason}", "no_pose")
    error = json.loads(messages.encode_reply(Request("reference"), reason))
    assert error["error"] == reason.text
