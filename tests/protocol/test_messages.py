"""JSON payloads: exact keys, plain numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.protocol import json_payload, messages
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Calibration, Disc, Geometry, Reconstruction, Slip, Touch, TouchedObject


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


def test_a_touch_is_numbers_by_name_with_their_deviations(make_result: Callable[..., Reconstruction]) -> None:
    reason = Reason(ReasonCode.TOUCH_RANGE, "outside the labelled range: force_z_n")
    touch = Touch({"depth_mm": 1.81251, "force_z_n": None}, {"depth_mm": 0.0625, "force_z_n": None}, reason)
    assert json.loads(messages.encode_touch(make_result(touch=touch))) == {
        "t_ns": 1_000,
        "seq": 5,
        "wall_ns": 2_000,
        "touch": {"depth_mm": 1.8125, "force_z_n": None},
        "touch_sigma": {"depth_mm": 0.0625, "force_z_n": None},
        "reason": "outside the labelled range: force_z_n",
        "reason_code": "touch_range",
    }


def test_without_contact_a_touch_is_null_for_the_frames_reason(make_result: Callable[..., Reconstruction]) -> None:
    torn = Reason(ReasonCode.TORN, "torn")
    free, invalid = make_result(contact=False), make_result(contact=False, valid=False, reason=torn)
    decoded = [json.loads(messages.encode_touch(result)) for result in (free, invalid)]
    assert [d["touch"] for d in decoded] == [d["touch_sigma"] for d in decoded] == [None, None]
    assert [(d["reason"], d["reason_code"]) for d in decoded] == [("", ""), ("torn", "torn")]


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
    assert json.loads(json_payload.encode_json({"captured": np.int64(3), "p99_ms": np.float32(1.5)})) == {
        "captured": 3,
        "p99_ms": 1.5,
    }
    with pytest.raises(TypeError):
        json_payload.encode_json({"captured": object()})
