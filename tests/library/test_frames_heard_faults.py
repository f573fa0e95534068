"""What no daemon publishes is nobody's result, and never an error: the listener goes on with the next frame."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.published_sensor import CRC, bump, calibration, dragged, uncertain

from tacshade_edge.library.frame_assembler import FrameAssembler
from tacshade_edge.protocol import messages, wire
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Reconstruction, Touch

INFO: dict[str, Any] = json.loads(
    messages.encode_info(version="0", config_digest="0", profile="fast", calibration=calibration())
)
TOUCHED = bump(7, 1.0, 236.0, 328.0, 8)


def heard(info: bytes = b"") -> FrameAssembler:
    frames = FrameAssembler()
    frames.add("info", json.dumps(INFO).encode())
    if info:
        frames.add("info", info)
    return frames


def show(frames: FrameAssembler, result: Reconstruction, other: Reconstruction | None = None) -> None:
    """Its frame, with shear and error of another."""
    other = other or result
    frames.add("height", wire.encode_height(result, calibration_crc32=CRC))
    frames.add("cloud", wire.encode_cloud(result, calibration_crc32=CRC))
    if other.shear_mm is not None:
        frames.add("shear", wire.encode_shear(other, calibration_crc32=CRC))
    if other.sigma_mm is not None:
        frames.add("sigma", wire.encode_sigma(other, calibration_crc32=CRC))
    frames.add("contact", messages.encode_contact(result, fps=30.0))


@pytest.mark.parametrize("key", ["radius_px", "skin_radius_mm", "visible_half_angle_deg", "camera_distance_mm"])
@pytest.mark.parametrize("value", ["0", "-0.0", "1e308", "1e-300", "1" + "0" * 400])
def test_a_geometry_that_no_sensor_has_leaves_the_last(key: str, value: str) -> None:
    changed = {**INFO, "geometry": {**INFO["geometry"], key: "?"}}
    frames = heard(json.dumps(changed).replace('"?"', value).encode())
    show(frames, TOUCHED)
    result = frames.take()
    assert result is not None
    assert result.geometry == calibration().geometry


@pytest.mark.parametrize(
    "other", [bump(7, 1.0, 236.0, 328.0, 4), replace(TOUCHED, height=replace(TOUCHED.height, row0=2.0))]
)
def test_shear_and_error_of_another_grid_pass_a_frame_over(other: Reconstruction) -> None:
    for made in (dragged(other, 1.0, 0.0), uncertain(other, 0.1)):
        frames = heard()
        show(frames, TOUCHED, made)
        assert frames.take() is None
        assert frames.passed_over == 1
        show(frames, replace(TOUCHED, seq=8))
        assert frames.take() is not None


def test_a_touch_of_another_frame_and_one_that_is_none_are_nobodys() -> None:
    frames = heard()
    outside = Touch({"x_mm": None}, {"x_mm": None}, Reason(ReasonCode.TOUCH_RANGE, "outside the labelled range: x_mm"))
    touched = replace(TOUCHED, touch=outside)
    for seq, payload, expected in (
        (7, messages.encode_touch(touched), {"x_mm": None}),
        (8, messages.encode_touch(touched), None),
        (9, b'{"seq":9,"t_ns":0,"touch":{"x_mm":1e300},"touch_sigma":{"x_mm":0}}', None),
    ):
        frames.add("touch", payload)
        show(frames, replace(TOUCHED, seq=seq))
        result = frames.take()
        assert result is not None
        assert result.touch == result.touch_sigma == expected
        told = ("outside the labelled range: x_mm", "touch_range") if expected else ("", "")
        assert (result.touch_reason, result.touch_reason_code) == told


def test_shear_without_a_height_passes_a_frame_over() -> None:
    frames, free = heard(), dragged(bump(7, 0.0, 236.0, 328.0, 8), 0.0, 0.0)
    frames.add("shear", wire.encode_shear(free, calibration_crc32=CRC))
    frames.add("contact", messages.encode_contact(free, fps=30.0))
    assert frames.take() is None


def test_a_height_beyond_the_skin_and_another_kind_pass_a_frame_over() -> None:
    frames = heard()
    show(frames, bump(7, 25.0, 236.0, 328.0, 8))
    assert frames.take() is None
    frames.add("height", wire.encode_cloud(TOUCHED, calibration_crc32=CRC))
    frames.add("cloud", wire.encode_cloud(TOUCHED, calibration_crc32=CRC))
    frames.add("contact", messages.encode_contact(TOUCHED, fps=30.0))
    assert frames.take() is None
    assert frames.passed_over == 2


def test_a_contact_and_a_state_that_are_none_are_nobodys() -> None:
    frames = heard()
    for payload in (b"{}", b'{"seq":-1,"t_ns":0,"contact":1}', b'{"seq":1,"t_ns":0,"contact":1e308}', b"[" * 60_000):
        frames.add("contact", payload)
    frames.add("state", b"\x1b[2J")
    assert not frames.whole
    assert frames.state == ""
    show(frames, TOUCHED)
    assert np.isfinite(frames.take().volume_mm3)  # type: ignore[union-attr]
