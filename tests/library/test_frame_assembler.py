"""What a daemon publishes of a frame gives the frame's own result;
what no daemon publishes is no error.
"""

from __future__ import annotations

import json
from contextlib import nullcontext, suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.calibrated_sensor import calibrated, pressed, step, unloaded
from support.published_sensor import CRC, bump, dragged, uncertain, unmeasured
from support.published_sensor import calibration as published_calibration
from tacshade_edge.errors import DecodeError
from tacshade_edge.library.frame_assembler import TOPICS, FrameAssembler
from tacshade_edge.mqtt.publishing import Publisher
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Frame, Pose, Reconstruction, Touch
from tacshade_edge.wire import binary, messages

POSE = Pose(5, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)
INFO: dict[str, Any] = json.loads(
    messages.encode_info(
        version="0", config_digest="0", profile="fast", calibration=published_calibration()
    )
)
TOUCHED = bump(7, 1.0, 236.0, 328.0, 8)


def info() -> bytes:
    return messages.encode_info(
        version="1", config_digest="", profile="balanced", calibration=calibrated()
    )


def frame(seq: int) -> Frame:
    return Frame(seq, 1000 + seq, 2000 + seq, np.zeros((1, 1), np.uint8), POSE, 7)


def published(*results: Reconstruction) -> list[tuple[str, bytes]]:
    """What the daemon's own publisher sends of them."""
    sent: list[tuple[str, bytes]] = []
    publisher = Publisher(
        lambda topic, payload, _: sent.append((topic, payload)), lambda *_: None, lambda *_: None
    )
    for result in results:
        publisher.see(FrameResult(frame(result.seq), calibrated(), result))
    return sent


def of(result: Reconstruction, seq: int) -> Reconstruction:
    return replace(result, seq=seq, t_ns=1000 + seq * 10**9, wall_ns=2000 + seq)


def heard(*sent: tuple[str, bytes]) -> FrameAssembler:
    frames = FrameAssembler()
    for topic, payload in (("info", info()), *sent):
        frames.add(topic, payload)
    return frames


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ball", "cube"])
def test_a_frame_heard_is_the_frame_published(name: str) -> None:
    made = of(step("balanced", pressed(name, 2.0).image), 7)
    result = heard(*published(made)).take()
    assert result is not None
    np.testing.assert_array_equal(result.contact, made.height.contact)
    np.testing.assert_array_equal(result.points_mm, made.cloud.points_mm)
    np.testing.assert_array_equal(result.labels, made.cloud.labels)
    for found, expected in (
        (result.height_mm, made.height.height_mm),
        (result.shear_mm, made.shear_mm),
    ):
        assert expected is not None
        np.testing.assert_allclose(found, expected, atol=0.000505)
    np.testing.assert_allclose(result.sigma_mm, made.sigma_mm, atol=0.000505)
    (found,), (expected,) = result.objects, made.objects
    assert found.label == expected.label
    for key in ("centroid_mm", "extent_mm", "normal"):
        assert getattr(found, key) == pytest.approx(getattr(expected, key), abs=0.002), key
    assert (found.area_mm2, result.volume_mm3) == pytest.approx(
        (expected.area_mm2, made.volume_mm3), rel=0.005
    )
    assert result.depth_max_mm == pytest.approx(made.depth_max_mm, abs=0.001)
    assert (result.seq, result.t_ns, result.wall_ns) == (7, made.t_ns, made.wall_ns)
    assert (result.valid, result.in_contact, result.profile) == (True, True, "balanced")
    assert result.pose == replace(POSE, t_ns=made.t_ns)
    assert made.touch is not None
    assert result.touch == pytest.approx(made.touch.values, abs=1e-4)
    assert result.touch_sigma == pytest.approx(made.touch.sigma, abs=1e-4)
    np.testing.assert_allclose(
        result.skin_mm()[result.contact][0], made.cloud.points_mm[0], atol=0.002
    )


@pytest.mark.slow
def test_the_end_of_a_contact_and_what_follows_are_zero_on_the_same_grid() -> None:
    touched, free = step("fast", pressed("ball", 2.0).image), step("fast", unloaded())
    sent = published(of(touched, 1), of(free, 2), of(free, 3))
    assert sum(topic == "contact" for topic, _ in sent) == 3
    frames = heard()
    results = []
    for topic, payload in sent:
        frames.add(topic, payload)
        if frames.whole:
            results.append(frames.take())
    shapes = {result.height_mm.shape for result in results if result}
    assert [(r.seq, r.in_contact, float(np.nanmax(r.height_mm)) > 0) for r in results if r] == [
        (1, True, True),
        (2, False, False),
        (3, False, False),
    ]
    assert len(shapes) == 1
    assert frames.passed_over == 0


@given(st.lists(st.tuples(st.sampled_from(TOPICS), st.binary(max_size=200))))
def test_no_bytes_break_it(sent: list[tuple[str, bytes]]) -> None:
    frames = heard()
    for topic, payload in sent:
        with suppress(DecodeError):
            frames.add(topic, payload)
    frames.take()
    assert frames.take() is None


def faulty() -> FrameAssembler:
    frames = FrameAssembler()
    frames.add("info", json.dumps(INFO).encode())
    return frames


def show(
    frames: FrameAssembler, result: Reconstruction, other: Reconstruction | None = None
) -> None:
    """Its frame, with shear and error of another."""
    other = other or result
    frames.add("height", binary.encode_height(result, calibration_crc32=CRC))
    frames.add("cloud", binary.encode_cloud(result, calibration_crc32=CRC))
    if other.shear_mm is not None:
        frames.add("shear", binary.encode_shear(other, calibration_crc32=CRC))
    if other.sigma_mm is not None:
        frames.add("sigma", binary.encode_sigma(other, calibration_crc32=CRC))
    frames.add("contact", messages.encode_contact(result, fps=30.0))


def test_what_is_not_whole_or_not_placed_is_passed_over() -> None:
    incomplete, unplaced, other, newer = faulty(), FrameAssembler(), faulty(), faulty()
    incomplete.add("height", binary.encode_height(TOUCHED, calibration_crc32=CRC))
    incomplete.add("contact", messages.encode_contact(TOUCHED, fps=30.0))
    assert not incomplete.whole
    for frames in (unplaced, other, newer):
        show(frames, TOUCHED)
    other.add(
        "info",
        json.dumps({**INFO, "geometry": {**INFO["geometry"], "calibration_crc32": 1}}).encode(),
    )
    assert unplaced.take() is other.take() is None
    assert unplaced.passed_over == other.passed_over == 1
    show(newer, replace(TOUCHED, seq=8))
    result = newer.take()
    assert result is not None
    assert (result.seq, newer.passed_over) == (8, 1)


@pytest.mark.parametrize(
    "other",
    [bump(7, 1.0, 236.0, 328.0, 4), replace(TOUCHED, height=replace(TOUCHED.height, row0=2.0))],
)
def test_shear_and_error_of_another_grid_pass_a_frame_over(other: Reconstruction) -> None:
    for made in (dragged(other, 1.0, 0.0), uncertain(other, 0.1)):
        frames = faulty()
        show(frames, TOUCHED, made)
        assert frames.take() is None
        assert frames.passed_over == 1
        show(frames, replace(TOUCHED, seq=8))
        assert frames.take() is not None


def test_a_touch_of_another_frame_and_one_that_is_none_are_nobodys() -> None:
    frames = faulty()
    outside = Touch(
        {"x_mm": None},
        {"x_mm": None},
        Reason(ReasonCode.TOUCH_RANGE, "outside the labelled range: x_mm"),
    )
    touched = replace(TOUCHED, touch=outside)
    for seq, payload, expected in (
        (7, messages.encode_touch(touched), {"x_mm": None}),
        (8, messages.encode_touch(touched), None),
        (9, b'{"seq":9,"t_ns":0,"touch":{"x_mm":1e300},"touch_sigma":{"x_mm":0}}', None),
    ):
        with nullcontext() if seq < 9 else pytest.raises(DecodeError):
            frames.add("touch", payload)
        show(frames, replace(TOUCHED, seq=seq))
        result = frames.take()
        assert result is not None
        assert result.touch == result.touch_sigma == expected
        reported = ("outside the labelled range: x_mm", "touch_range") if expected else ("", "")
        assert (result.touch_reason, result.touch_reason_code) == reported


def test_what_does_not_fit_together_passes_a_frame_over() -> None:
    frames, free = faulty(), dragged(bump(7, 0.0, 236.0, 328.0, 8), 0.0, 0.0)
    frames.add("shear", binary.encode_shear(free, calibration_crc32=CRC))  # without a height
    frames.add("contact", messages.encode_contact(free, fps=30.0))
    assert frames.take() is None
    frames = faulty()
    show(frames, bump(7, 25.0, 236.0, 328.0, 8))
    assert frames.take() is None
    frames.add("height", binary.encode_cloud(TOUCHED, calibration_crc32=CRC))
    frames.add("cloud", binary.encode_cloud(TOUCHED, calibration_crc32=CRC))
    frames.add("contact", messages.encode_contact(TOUCHED, fps=30.0))
    assert frames.take() is None
    assert frames.passed_over == 2


def test_objects_have_the_names_that_the_daemon_published_until_the_contact_ends() -> None:
    touching = of(TOUCHED, 7)
    named = replace(TOUCHED.objects[0], name="nut_m8", probability=0.97)
    event = "event/object", messages.encode_object(touching, named)
    info = (
        "info",
        messages.encode_info(
            version="1", config_digest="", profile="fast", calibration=published_calibration()
        ),
    )
    frames = FrameAssembler()

    def names(*sent: tuple[str, bytes]) -> list[tuple[str | None, float | None]]:
        for topic, payload in sent:
            frames.add(topic, payload)
        result = frames.take()
        assert result is not None
        return [(each.name, each.probability) for each in result.objects[:1]]

    assert names(info, *own(touching)) == [(None, None)]
    assert names(event, *own(of(TOUCHED, 8))) == [("nut_m8", 0.97)]
    assert names(*own(unmeasured(9, 8))) == []
    assert names(*own(of(TOUCHED, 9))) == [("nut_m8", 0.97)]
    assert names(*own(of(bump(10, 0.0, 236.0, 328.0, 8), 10))) == []
    assert names(*own(of(TOUCHED, 11))) == [(None, None)]


def test_a_touch_of_unknown_depth_is_neither_contact_nor_none() -> None:
    info = messages.encode_info(
        version="1", config_digest="", profile="fast", calibration=published_calibration()
    )
    frames = FrameAssembler()
    for topic, payload in (("info", info), *own(unmeasured(7, 8))):
        frames.add(topic, payload)
    result = frames.take()
    assert result is not None
    assert (result.in_contact, result.touched, result.valid) == (False, True, True)
    assert np.isnan(result.depth_max_mm)
    assert result.degraded_code == "touch_unmeasured"
    assert "touched, depth unknown" in repr(result)


def own(result: Reconstruction) -> list[tuple[str, bytes]]:
    """The messages of a frame of the published sensor."""
    crc32 = binary.Taken(calibration_crc32=CRC, pose=None, pose_error_us=0)
    return [
        ("height", binary.encode_height(result, **crc32)),
        *([("cloud", binary.encode_cloud(result, **crc32))] if result.contact else []),
        ("contact", messages.encode_contact(result, fps=1.0)),
    ]
