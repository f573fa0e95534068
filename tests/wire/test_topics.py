"""What is reported in JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.networks import fitted_with
from support.published_sensor import calibration, health
from tacshade_edge.errors import DecodeError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import (
    Calibration,
    Disc,
    Geometry,
    Reconstruction,
    Slip,
    Touch,
    TouchedObject,
)
from tacshade_edge.wire import binary, codec, messages, topics

INFO: dict[str, Any] = json.loads(
    messages.encode_info(version="0", config_digest="0", profile="fast", calibration=calibration())
)
TOUCHES = json.loads((Path(__file__).parent / "vectors" / "touch.json").read_text())


def test_contact_is_flat_numbers_with_the_promised_keys(
    make_result: Callable[..., Reconstruction], two_objects: tuple[TouchedObject, ...]
) -> None:
    result = make_result(objects=two_objects, volume_mm3=np.float64(3.5))
    contact = json.loads(messages.encode_contact(result, fps=59.5))
    expected = {
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
        "touched": 0,
    }
    assert list(contact.items()) == list(expected.items())  # in this order
    free = json.loads(
        messages.encode_contact(make_result(contact=False, volume_mm3=math.nan), fps=math.inf)
    )
    assert [free[k] for k in ("contact", "depth_max_mm", "objects", "x_mm", "volume_mm3")] == [
        0,
        0.0,
        0,
        None,
        None,
    ]


def test_a_touch_of_unknown_depth_has_no_numbers(
    make_result: Callable[..., Reconstruction],
) -> None:
    unmeasured = Reason(ReasonCode.TOUCH_UNMEASURED, "something touches")
    result = make_result(contact=False, touched=True, degraded=unmeasured)
    contact = json.loads(messages.encode_contact(result, fps=1.0))
    assert (contact["contact"], contact["touched"]) == (0, 1)
    assert contact["degraded_code"] == "touch_unmeasured"
    assert {contact[key] for key in ("depth_max_mm", "area_mm2", "volume_mm3")} == {None}
    touch = json.loads(messages.encode_touch(result))
    assert (touch["touch"], touch["reason_code"]) == (None, "touch_unmeasured")


def test_an_older_daemons_contact_has_no_touch_of_unknown_depth() -> None:
    assert topics.decode_contact(b'{"t_ns": 1, "seq": 2, "contact": 0}').touched == 0


def test_a_touch_is_numbers_by_name_with_their_deviations(
    make_result: Callable[..., Reconstruction],
) -> None:
    reason = Reason(ReasonCode.TOUCH_RANGE, "outside the labelled range: force_z_n")
    touch = Touch(
        {"depth_mm": 1.81251, "force_z_n": None}, {"depth_mm": 0.0625, "force_z_n": None}, reason
    )
    assert json.loads(messages.encode_touch(make_result(touch=touch))) == {
        "t_ns": 1_000,
        "seq": 5,
        "wall_ns": 2_000,
        "touch": {"depth_mm": 1.8125, "force_z_n": None},
        "touch_sigma": {"depth_mm": 0.0625, "force_z_n": None},
        "reason": "outside the labelled range: force_z_n",
        "reason_code": "touch_range",
    }


def test_contact_reports_the_most_of_what_moves(
    make_result: Callable[..., Reconstruction], two_objects: tuple[TouchedObject, ...]
) -> None:
    one = replace(
        two_objects[0], shear_mm=(0.5, -0.5), twist_deg=3.0, slip=Slip.PARTIAL, slip_mm_s=0.5
    )
    other = replace(
        two_objects[1], shear_mm=(-2.0, 0.25), twist_deg=-4.0, slip=Slip.FULL, slip_mm_s=6.0
    )
    decoded = json.loads(messages.encode_contact(make_result(objects=(one, other)), fps=1.0))
    moves = [decoded[k] for k in ("shear_x_mm", "shear_y_mm", "twist_deg", "slip", "slip_mm_s")]
    assert moves == [-2.0, 0.25, -4.0, 2, 6.0]


def test_info_places_a_pixel_in_mm() -> None:
    disc = Disc(239.5, np.float64(319.5), 200.0)  # type: ignore[arg-type]
    calibration = Calibration(
        geometry=Geometry(20.0, None, 30.0, disc),
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
    payload = messages.encode_info(
        version="1",
        config_digest="ab",
        profile="fast",
        calibration=calibration,
        profiles=("fast", "paper"),
    )
    info = json.loads(payload)
    assert info["reference"] is None
    assert info["fitted"] == []
    again = messages.encode_info(
        version="1",
        config_digest="ab",
        profile="fast",
        calibration=fitted_with("fast", calibration),
    )
    assert json.loads(again)["fitted"] == ["fast"]
    assert (info["hand_id"], info["hand_T_sensor"]) == (None, None)
    assert {
        k: info[k]
        for k in ("version", "wire_version", "config_digest", "profile", "profiles", "choice")
    } == {
        "version": "1",
        "wire_version": 1,
        "config_digest": "ab",
        "profile": "fast",
        "profiles": ["fast", "paper"],
        "choice": "fast",
    }
    shows_no_camera_distance(info["geometry"])


def shows_no_camera_distance(geometry: dict[str, Any]) -> None:
    """The geometry of `test_info_places_a_pixel_in_mm`, which has 1 mm in 20 px."""
    assert geometry["camera_distance_mm"] is None
    assert geometry["mm_per_px"] == pytest.approx(0.05)
    assert (geometry["row_c"], geometry["col_c"], geometry["radius_px"]) == (239.5, 319.5, 200.0)
    assert (geometry["skin_radius_mm"], geometry["visible_half_angle_deg"], geometry["f_px"]) == (
        20.0,
        30.0,
        0.0,
    )
    assert geometry["calibration_crc32"] == 0xDEADBEEF
    assert geometry["flange_T_sensor"] == [0, 0, 0, 1, 0, 0, 0]


@pytest.mark.parametrize("distance_mm", [None, 27.0])
def test_info_of_a_pad_has_no_radius_and_no_angle(distance_mm: float | None) -> None:
    flat = Geometry(math.inf, distance_mm, 0.0, Disc(239.5, 319.5, 200.0), 15.0)
    payload = messages.encode_info(
        profile="fast", calibration=replace(calibration(), geometry=flat)
    )
    said = json.loads(payload)["geometry"]
    assert (said["skin"], said["visible_radius_mm"], said["mm_per_px"]) == ("pad", 15.0, 0.075)
    assert (said["skin_radius_mm"], said["visible_half_angle_deg"]) == (None, None)
    info = topics.decode_info(payload)
    assert info.geometry is not None
    assert info.geometry.geometry == flat
    for changes in ({"skin": "dome"}, {"visible_radius_mm": None}, {"visible_radius_mm": -1}):
        wrong = json.dumps({**INFO, "geometry": {**said, **changes}}).encode()
        with pytest.raises(DecodeError):
            topics.decode_info(wrong)


def test_status_and_health() -> None:
    absent = Reason(ReasonCode.ABSENT, "no such device")
    status = messages.encode_status(
        "failed", absent, {"rate_hz": 60.0, "state": "details do not win"}
    )
    expected = {
        "rate_hz": 60.0,
        "state": "failed",
        "reason": "no such device",
        "reason_code": "absent",
    }
    assert json.loads(status) == expected
    assert json.loads(messages.encode_status("idle")) == {
        "state": "idle",
        "reason": "",
        "reason_code": "",
    }
    assert json.loads(codec.encode_json({"captured": np.int64(3), "p99_ms": np.float32(1.5)})) == {
        "captured": 3,
        "p99_ms": 1.5,
    }
    with pytest.raises(TypeError):
        codec.encode_json({"captured": object()})


def test_what_a_daemon_reports_is_understood() -> None:
    info = topics.decode_info(json.dumps(INFO).encode())
    assert info.geometry is not None
    assert info.geometry.geometry == calibration().geometry
    assert topics.decode_health(health()).frames["captured"] == 3
    assert topics.decode_status("status/camera", b"") == topics.Status()
    assert [topics.decode_state(state.encode()) for state in topics.STATES] == list(topics.STATES)


@pytest.mark.parametrize(
    "key",
    [
        "radius_px",
        "skin_radius_mm",
        "visible_half_angle_deg",
        "camera_distance_mm",
        "row_c",
        "image_width_px",
    ],
)
@pytest.mark.parametrize("value", ["-1e9", "1e308", "1e999", "1" + "0" * 400, "[]"])
def test_a_geometry_that_no_sensor_has_is_refused(key: str, value: str) -> None:
    changed = (
        json.dumps({**INFO, "geometry": {**INFO["geometry"], key: "?"}})
        .replace('"?"', value)
        .encode()
    )
    with pytest.raises(DecodeError, match=r"^info: "):
        topics.decode_info(changed)


@pytest.mark.parametrize("vector", TOUCHES, ids=lambda vector: str(vector["name"]))
def test_a_touch_is_understood_or_refused(vector: dict[str, Any]) -> None:
    payload = vector["payload"].encode()
    if "error" in vector:
        with pytest.raises(
            DecodeError, match=r"^touch: .*; expected the format in docs/reference/mqtt.md"
        ):
            topics.decode_touch(payload)
        return
    touch = topics.decode_touch(payload)
    assert {key: getattr(touch, key) for key in vector["expect"]} == vector["expect"]


@pytest.mark.parametrize("sent", [b"", b"on line", b"online\n", b"\xff", b"x" * 10_000_000])
def test_a_state_that_is_none_is_refused_in_one_line(sent: bytes) -> None:
    with pytest.raises(
        DecodeError, match="expected one of online, degraded, stopped, offline"
    ) as refused:
        topics.decode_state(sent)
    assert len(str(refused.value)) < 200


@pytest.mark.parametrize(
    "changed",
    [
        {"frames": {"published": -1}},
        {"frames": {'a"} 1\nforged{x="': 1}},
        {"frames": {f"k{n}": 0 for n in range(65)}},
        {"uptime_s": 1e300},
        {"stages_ms": {"solve": {"p50": 0, "p99": None}}},
        {"invalid_reason_code": "torn\n"},
    ],
)
def test_a_health_that_no_daemon_reports_is_refused(changed: dict[str, Any]) -> None:
    with pytest.raises(DecodeError, match=r"^health: "):
        topics.decode_health(json.dumps({**json.loads(health()), **changed}).encode())


def test_a_payload_of_another_kind_is_refused() -> None:
    cloud = binary.encode_map_cloud(
        np.zeros((0, 3), np.float32), revision=1, calibration_crc32=0, t_ns=0, wall_ns=0
    )
    with pytest.raises(DecodeError, match="height: found a CloudMessage, expected a HeightMessage"):
        topics.OF_SENSORS["height"].decode("height", cloud)
    assert topics.decode_preview("preview", b"\xff\xd8\xff") == b"\xff\xd8\xff"
    with pytest.raises(DecodeError, match="expected a JPEG image"):
        topics.decode_preview("preview", b"GIF")
