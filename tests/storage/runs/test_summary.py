"""A record of `summary.json`: the touch, what is not known of it, and none."""

from __future__ import annotations

from dataclasses import replace

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.storage.runs.summary import summary
from tacshade_edge.types import Frame, Touch
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration

KEYS = ("touch", "touch_sigma", "touch_reason", "touch_reason_code")


def test_a_touch_is_numbers_with_their_deviations_and_why_one_is_missing() -> None:
    made = make_reconstructor(painted_calibration(), PROFILES["balanced"]).step(Frame(0, 0, 0, TOUCHED))
    record = summary(made)
    assert list(record["touch"]) == list(record["touch_sigma"])
    assert record["touch"]["depth_mm"] == record["depth_max_mm"] > 0
    assert record["touch_sigma"]["depth_mm"] > 0
    assert (record["touch_reason"], record["touch_reason_code"]) == ("", "")
    outside = Touch({"depth_mm": 1.23456, "force_z_n": None}, {"depth_mm": 0.01234, "force_z_n": None},
                    Reason(ReasonCode.TOUCH_RANGE, "outside"))  # fmt: skip
    record = summary(replace(made, touch=outside))
    assert [record[key] for key in KEYS] == [
        {"depth_mm": 1.2346, "force_z_n": None},
        {"depth_mm": 0.0123, "force_z_n": None},
        "outside",
        "touch_range",
    ]


def test_without_contact_there_is_no_touch() -> None:
    record = summary(make_reconstructor(painted_calibration(), PROFILES["fast"]).step(Frame(0, 0, 0, FREE)))
    assert [record[key] for key in KEYS] == [None, None, "", ""]
