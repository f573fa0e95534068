"""Height and cloud payloads against literal vectors, and at the extremes."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from tacshade_edge.errors import DecodeError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import HeightMap, ObjectCloud, Pose, Reconstruction
from tacshade_edge.wire import binary

GLARE = Reason(ReasonCode.GLARE, "glare hides 5 % of the disc")
METADATA = (
    "seq",
    "calibration_crc32",
    "t_ns",
    "wall_ns",
    "contact",
    "invalid",
    "saturated",
    "degraded",
    "touched",
)
FLAGS = st.fixed_dictionaries(
    {name: st.booleans() for name in ("valid", "contact", "saturated", "touched")}
    | {"degraded": st.sampled_from([None, GLARE])}
)
KINDS: dict[type, tuple[str, str]] = {
    binary.HeightMessage: ("height", "height_mm"),
    binary.CloudMessage: ("cloud", "points_mm"),
    binary.ShearMessage: ("shear", "shear_mm"),
    binary.SigmaMessage: ("sigma", "sigma_mm"),
}
FLOATS = st.floats(width=32, allow_nan=True, allow_infinity=True)


def reconstruction(
    height: Any, points: Any = None, labels: Any = None, **other: Any
) -> Reconstruction:
    fields: dict[str, Any] = {
        "seq": 1,
        "t_ns": 2,
        "wall_ns": 3,
        "valid": True,
        "contact": True,
        "saturated": False,
    }
    fields |= {"degraded": None, "profile": "fast", "reason": None} | other
    points = np.zeros((0, 3), np.float32) if points is None else points
    labels = np.zeros(len(points), np.uint16) if labels is None else labels
    grid = HeightMap(height, np.zeros(height.shape, np.bool_), 0.5, 1.5, 2.0)
    return Reconstruction(height=grid, cloud=ObjectCloud(points, labels), **fields)


def from_vector(expect: dict[str, Any]) -> tuple[Reconstruction, Pose | None]:
    """What one would have encoded to get a vector."""
    height = np.array(
        [np.nan if h is None else h for h in expect.get("height_mm", [0.0])], np.float32
    )
    points = np.array(expect.get("points_mm", []), np.float32).reshape(-1, 3)
    shear = np.array([np.nan if s is None else s for s in expect.get("shear_mm", [])], np.float32)
    sigma = np.array([np.nan if s is None else s for s in expect.get("sigma_mm", [])], np.float32)
    if shear.size or sigma.size:
        height = np.zeros((expect["rows"], expect["cols"]), np.float32)
    result = Reconstruction(
        seq=expect["seq"],
        t_ns=expect["t_ns"],
        wall_ns=expect["wall_ns"],
        profile="fast",
        valid=not expect["invalid"],
        reason=None,
        contact=expect["contact"],
        saturated=expect["saturated"],
        degraded=GLARE if expect["degraded"] else None,
        height=HeightMap(
            height.reshape(expect.get("rows", 1), -1),
            np.zeros((1, 1), np.bool_),
            expect.get("row0", 0.0),
            expect.get("col0", 0.0),
            expect.get("step_px", 0.0),
        ),
        cloud=ObjectCloud(points, np.array(expect.get("labels", []), np.uint16)),
        touched=expect["touched"],
        shear_mm=shear.reshape(*height.shape, 2) if shear.size else None,
        sigma_mm=sigma.reshape(height.shape) if sigma.size else None,
    )
    return result, Pose(expect["t_ns"], *expect["pose"]) if expect["pose"] else None


def test_sound_vector_decodes_to_its_values(sound: dict[str, Any]) -> None:
    expect = sound["expect"]
    message = binary.decode(bytes.fromhex(sound["hex"]))
    assert {k: getattr(message, k) for k in METADATA} == {k: expect[k] for k in METADATA}
    assert message.pose == (Pose(expect["t_ns"], *expect["pose"]) if expect["pose"] else None)
    assert message.pose_error_us == expect["pose_error_us"]
    kind, name = KINDS[type(message)]
    assert expect["kind"] == kind
    values = getattr(message, name)
    if isinstance(message, binary.CloudMessage):
        assert values.shape == (expect["n"], 3)
        assert message.labels.tolist() == expect["labels"]
    else:
        assert (message.row0, message.col0, message.step_px) == (
            expect["row0"],
            expect["col0"],
            expect["step_px"],
        )
        assert values.shape == (expect["rows"], expect["cols"], 2)[: values.ndim]
    wanted = np.array([np.nan if v is None else v for v in expect[name]])
    np.testing.assert_allclose(values.ravel(), wanted, rtol=1e-6, atol=1e-7)
    assert not values.flags.writeable


def test_encoder_writes_the_vector_byte_for_byte(own: dict[str, Any]) -> None:
    expect = own["expect"]
    result, pose = from_vector(expect)
    data = getattr(binary, f"encode_{expect['kind']}")(
        result,
        calibration_crc32=expect["calibration_crc32"],
        pose=pose,
        pose_error_us=expect["pose_error_us"],
    )
    assert data.hex() == own["hex"]


def test_a_map_cloud_is_the_vector_byte_for_byte(mapped: dict[str, Any]) -> None:
    expect = mapped["expect"]
    points = np.array(expect["points_mm"], np.float32).reshape(-1, 3)
    fields = {k: expect[k] for k in ("calibration_crc32", "t_ns", "wall_ns")}
    assert binary.encode_map_cloud(points, revision=expect["seq"], **fields).hex() == mapped["hex"]


def test_damaged_vector_is_refused_with_what_and_where(damaged: dict[str, Any]) -> None:
    with pytest.raises(DecodeError, match=damaged["error"]):
        binary.decode(bytes.fromhex(damaged["hex"]))


@given(
    npst.arrays(
        np.float32,
        npst.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=12),
        elements=FLOATS | st.floats(-4e4, 4e4, width=32),
    ),
    FLAGS,
)
def test_any_height_is_rounded_or_clamped_and_never_wrapped(
    height: Any, flags: dict[str, Any]
) -> None:
    result = reconstruction(height, **flags)
    message = binary.decode(binary.encode_height(result, calibration_crc32=9))
    assert isinstance(message, binary.HeightMessage)
    high_mm = float(np.nanmax(np.abs(height), initial=0.0, where=~np.isnan(height)))
    # What fits by a scale is whole; beyond 32.767 m nothing is a depth.
    most_mm = 32.767 if high_mm > 32767 else max(high_mm, 32.767)
    expected = np.clip(height.astype(np.float64), -most_mm, most_mm)
    np.testing.assert_array_equal(np.isnan(message.height_mm), np.isnan(height))
    inside = ~np.isnan(height)
    step_mm = 0.001 * max(1, math.ceil(most_mm / 32.767 - 1e-9))
    assert np.all(np.abs(message.height_mm[inside] - expected[inside]) <= 0.505 * step_mm)
    assert message.invalid is not flags["valid"]
    assert message.degraded is (flags["degraded"] is not None)
    assert (message.contact, message.saturated) == (flags["contact"], flags["saturated"])


@given(st.integers(0, 40).flatmap(lambda n: st.tuples(*_cloud(n))), st.integers(0, 2**40))
def test_any_cloud_comes_back_bit_for_bit(cloud: tuple[Any, Any], seq: int) -> None:
    points, labels = cloud
    result = reconstruction(np.zeros((1, 1), np.float32), points, labels, seq=seq)
    message = binary.decode(bytearray(binary.encode_cloud(result, calibration_crc32=2**32 - 1)))
    assert isinstance(message, binary.CloudMessage)
    assert message.points_mm.tobytes() == points.tobytes()
    assert message.labels.tobytes() == labels.tobytes()
    assert message.seq == seq % 2**32


def _cloud(n: int) -> tuple[st.SearchStrategy[Any], ...]:
    placed = st.floats(-1e7, 1e7, width=32)
    return npst.arrays(np.float32, (n, 3), elements=placed), npst.arrays(np.uint16, n)


def test_grid_that_the_header_cannot_hold_is_an_error_not_a_wrap() -> None:
    wide = np.zeros((1, 65_536), np.float32)
    with pytest.raises(ValueError, match="65535"):
        binary.encode_height(reconstruction(wide), calibration_crc32=0)


@given(st.binary(max_size=200))
def test_garbage_is_a_decode_error(data: bytes) -> None:
    with pytest.raises(DecodeError):
        binary.decode(data)


@given(st.integers(0, 107), st.integers(1, 255))
def test_no_flipped_byte_passes_except_in_the_reserved_word(offset: int, flip: int) -> None:
    data = bytearray(
        binary.encode_height(
            reconstruction(np.ones((2, 3), np.float32)),
            calibration_crc32=7,
        )
    )
    data[offset] ^= flip
    if 92 <= offset < 96:
        assert isinstance(binary.decode(data), binary.HeightMessage)
    else:
        with pytest.raises(DecodeError):
            binary.decode(data)


def test_size_field_cannot_make_the_decoder_allocate() -> None:
    head = bytearray(96)
    struct.pack_into("<4s4B", head, 0, b"TCSH", 1, 2, 0, 0)
    struct.pack_into("<I", head, 32, 0xFFFFFFFF)
    with pytest.raises(DecodeError, match="4294967295 cells or points"):
        binary.decode(head)


def test_numbers_that_no_sensor_has_are_refused() -> None:
    made = reconstruction(
        np.zeros((2, 2), np.float32), np.zeros((1, 3), np.float32), np.ones(1, np.uint16)
    )
    for name, value in (("step_px", 0.0), ("step_px", np.inf), ("row0", np.nan), ("col0", 1e30)):
        payload = binary.encode_height(
            replace(made, height=replace(made.height, **{name: value})), calibration_crc32=0
        )
        with pytest.raises(DecodeError, match="byte 36"):
            binary.decode(payload)
    for value in (np.nan, np.inf, 2e7):
        cloud = replace(made.cloud, points_mm=np.full((1, 3), value, np.float32))
        with pytest.raises(DecodeError, match="found a point"):
            binary.decode(binary.encode_cloud(replace(made, cloud=cloud), calibration_crc32=0))
    for pose, where in (
        ((np.nan, 0, 0, 1, 0, 0, 0), "byte 56"),
        ((0, 0, 0, 0, 0, 0, 0), "byte 68"),
    ):
        payload = binary.encode_height(made, calibration_crc32=0, pose=Pose(0, *map(float, pose)))
        with pytest.raises(DecodeError, match=where):
            binary.decode(payload)


def test_a_map_has_a_cell_and_no_more_than_any_camera() -> None:
    for rows, cols in ((0, 0), (0, 7), (5, 0)):
        payload = binary.encode_height(
            reconstruction(np.zeros((rows, cols), np.float32)), calibration_crc32=0
        )
        with pytest.raises(DecodeError, match="byte 32"):
            binary.decode(payload)
    head = bytearray(
        binary.encode_height(reconstruction(np.zeros((1, 1), np.float32)), calibration_crc32=0)
    )
    struct.pack_into("<2H", head, 32, 2048, 2049)
    with pytest.raises(DecodeError, match="4196352 cells"):
        binary.decode(head)
