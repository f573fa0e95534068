"""Replies: they echo the transaction, and results have the serial line's words."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tacshade_edge.protocol import replies
from tacshade_edge.protocol.requests import Request
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


def test_replies_echo_the_transaction() -> None:
    done: Any = json.loads(replies.encode_result("t", {"profile": "fast"}))
    assert done == {"transaction": "t", "ok": True, "result": {"profile": "fast"}}
    refused = json.loads(replies.encode_error(None, Reason(ReasonCode.UNKNOWN_PROFILE, "no such profile")))
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
    payload = replies.encode_result(None, result)
    assert json.loads(payload)["result"] == written
    assert [*json.loads(payload)["result"]] == [*written]  # in that order
    if not isinstance(result, ProfileChosen):
        words = dict(word.split("=") for word in result_text(result).split())
        without = {key: value for key, value in written.items() if not key.startswith("reason")}  # a line is short
        assert {key: value if key == "name" else float(value) for key, value in words.items()} == without


def test_the_error_of_stitch_begins_with_the_serial_lines_word() -> None:
    reason = Reason(ReasonCode.NO_POSE, "frame 812: the robot's pose at the frame's time is unknown")
    error = json.loads(replies.encode_reply(Request("stitch", 5, action="add"), reason))
    assert (error["transaction"], error["error"], error["reason_code"]) == (5, f"NOPOSE: {reason}", "no_pose")
    error = json.loads(replies.encode_reply(Request("reference"), reason))
    assert error["error"] == reason.text
