"""What a daemon publishes of a frame gives the result that the frame itself gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.calibrated_sensor import calibrated, pressed, step, unloaded

import tacshade_edge as ts
from tacshade_edge.daemon.observer import FrameResult
from tacshade_edge.daemon.publishing import Publisher
from tacshade_edge.library.frame_assembler import TOPICS, FrameAssembler
from tacshade_edge.protocol import messages
from tacshade_edge.types import Frame, Pose, Reconstruction

pytestmark = pytest.mark.slow

POSE = Pose(5, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)


def info() -> bytes:
    return messages.encode_info(version="1", config_digest="", profile="balanced", calibration=calibrated())


def frame(seq: int) -> Frame:
    return Frame(seq, 1000 + seq, 2000 + seq, np.zeros((1, 1), np.uint8), POSE, 7)


def published(*results: Reconstruction) -> list[tuple[str, bytes]]:
    """What the daemon's own publisher sends of them."""
    sent: list[tuple[str, bytes]] = []
    publisher = Publisher(lambda topic, payload, _: sent.append((topic, payload)), lambda *_: None, lambda *_: None)
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


@pytest.mark.parametrize("name", ["ball", "cube"])
def test_a_frame_heard_is_the_frame_published(name: str) -> None:
    made = of(step("balanced", pressed(name, 2.0).image), 7)
    result = heard(*published(made)).take()
    assert result is not None
    np.testing.assert_array_equal(result.contact, made.height.contact)
    np.testing.assert_array_equal(result.points_mm, made.cloud.points_mm)
    np.testing.assert_array_equal(result.labels, made.cloud.labels)
    for found, expected in ((result.height_mm, made.height.height_mm), (result.shear_mm, made.shear_mm)):
        assert expected is not None
        np.testing.assert_allclose(found, expected, atol=0.000505)
    np.testing.assert_allclose(result.sigma_mm, made.sigma_mm, atol=0.000505)
    (found,), (expected,) = result.objects, made.objects
    assert found.label == expected.label
    for key in ("centroid_mm", "extent_mm", "normal"):
        assert getattr(found, key) == pytest.approx(getattr(expected, key), abs=0.002), key
    assert (found.area_mm2, result.volume_mm3) == pytest.approx((expected.area_mm2, made.volume_mm3), rel=0.005)
    assert result.depth_max_mm == pytest.approx(made.depth_max_mm, abs=0.001)
    assert (result.seq, result.t_ns, result.wall_ns) == (7, made.t_ns, made.wall_ns)
    assert (result.valid, result.in_contact, result.profile) == (True, True, "balanced")
    assert result.pose == replace(POSE, t_ns=made.t_ns)
    assert made.touch is not None
    assert result.touch == pytest.approx(made.touch.values, abs=1e-4)
    assert result.touch_sigma == pytest.approx(made.touch.sigma, abs=1e-4)
    np.testing.assert_allclose(result.skin_mm()[result.contact][0], made.cloud.points_mm[0], atol=0.002)


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


def test_what_is_not_whole_or_not_placed_is_passed_over() -> None:
    made = of(step("fast", pressed("ball", 2.0).image), 7)
    sent = published(made)
    without_cloud = [message for message in sent if message[0] != "cloud"]
    assert not heard(*without_cloud).whole
    unplaced = FrameAssembler()
    for message in sent:
        unplaced.add(*message)
    assert unplaced.take() is None
    assert unplaced.passed_over == 1
    other = heard(*sent)
    changed = replace(calibrated(), crc32=1)
    other.add("info", messages.encode_info(version="1", config_digest="", profile="fast", calibration=changed))
    assert other.take() is None
    newer = heard(*sent, *published(of(made, 8)))
    result = newer.take()
    assert result is not None
    assert (result.seq, newer.passed_over) == (8, 1)


def test_before_a_calibration_a_reason_is_kept() -> None:
    frames = heard()
    missing = ts.ConfigError("not calibrated").reason
    frames.add("info", messages.encode_info(version="1", config_digest="", profile="", calibration=missing))
    assert frames.info.reason == "not calibrated"


@given(st.lists(st.tuples(st.sampled_from(TOPICS), st.binary(max_size=200))))
def test_no_bytes_break_it(sent: list[tuple[str, bytes]]) -> None:
    frames = heard(*sent)
    frames.take()
    assert frames.take() is None
