"""The ROS 2 messages of the bridge, through others' definitions and CDR: rosbags writes the same
bytes, and mcap-ros2-support reads the same values.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from support.published_sensor import CRC, bump, health
from tacshade_edge.bridge import ros_messages as made
from tacshade_edge.bridge.ros_health import diagnosis
from tacshade_edge.types import U8, Pose
from tacshade_edge.wire import binary
from tacshade_edge.wire.sensor_topics import TouchNumbers
from tacshade_edge.wire.topics import decode_health

PRESS = bump(7, 2.0, 236.0, 328.0, step_px=4)
FRAME = "left_index_sensor_optical"
KINDS = (made.IMAGE, made.CLOUD, made.WRENCH, made.TRANSFORMS, made.DIAGNOSTICS)


@cache
def store(name: str = "ROS2_JAZZY") -> Any:
    typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")
    return typesys.get_typestore(typesys.Stores[name])


def read(payload: bytearray, kind: made.RosType) -> Any:
    """What rosbags reads, after it has written the same bytes, and another has read the same."""
    message = store().deserialize_cdr(bytes(payload), kind.name)
    assert bytes(store().serialize_cdr(message, kind.name)) == payload
    dynamic = pytest.importorskip("mcap_ros2._dynamic", reason="mcap-ros2-support is missing")
    definition, _ = store().generate_msgdef(kind.name, ros_version=2)
    (decode,) = [
        decoder
        for name, decoder in dynamic.generate_dynamic(kind.name, definition).items()
        if name == kind.name
    ]
    assert_same(decode(bytes(payload)), message)
    return message


def assert_same(one: Any, other: Any) -> None:
    """Two libraries' values of a message, field by field."""
    if isinstance(other, np.ndarray):
        np.testing.assert_array_equal(np.frombuffer(one, other.dtype), other)
    elif isinstance(other, list):
        assert len(one) == len(other)
        for each, that in zip(one, other, strict=True):
            assert_same(each, that)
    elif hasattr(other, "__msgtype__"):
        for name in other.__dataclass_fields__:
            # The rest are constants of the definition.
            if name.islower() and name != "__msgtype__":
                assert_same(getattr(one, name), getattr(other, name))
    else:
        assert one == other


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


@pytest.mark.parametrize("release", ["ROS2_JAZZY", "ROS2_KILTED", "ROS2_LYRICAL"])
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_the_hashes_are_those_of_the_definitions(kind: made.RosType, release: str) -> None:
    assert store(release).hash_rihs01(kind.name) == kind.rihs01


def test_a_height() -> None:
    message = binary.decode(binary.encode_height(PRESS, calibration_crc32=CRC))
    assert isinstance(message, binary.HeightMessage)
    image = read(made.height(message, FRAME), made.IMAGE)
    assert (image.encoding, image.height, image.width) == ("32FC1", 120, 160)
    assert (image.step, image.is_bigendian) == (640, 0)
    assert (image.header.frame_id, stamp_ns(image)) == (FRAME, PRESS.wall_ns)
    np.testing.assert_allclose(
        image.data.view("<f4").reshape(120, 160), message.height_mm / 1000, rtol=1e-6
    )


def test_an_unusable_frame_has_no_heights() -> None:
    message = binary.decode(
        binary.encode_height(replace(PRESS, valid=False), calibration_crc32=CRC)
    )
    assert isinstance(message, binary.HeightMessage)
    assert np.isnan(read(made.height(message, FRAME), made.IMAGE).data.view("<f4")).all()


def test_a_picture() -> None:
    grey: U8 = np.arange(15, dtype=np.uint8).reshape(3, 5)
    image = read(made.camera(grey, 1_500_000_000, FRAME), made.IMAGE)
    assert (image.encoding, image.height, image.width, image.step) == ("8UC1", 3, 5, 5)
    assert stamp_ns(image) == 1_500_000_000
    np.testing.assert_array_equal(image.data, grey.ravel())


@pytest.mark.parametrize("depth_mm", [2.0, 0.0])
def test_a_cloud(depth_mm: float) -> None:
    result = bump(7, depth_mm, 236.0, 328.0, step_px=4)
    message = binary.decode(binary.encode_cloud(result, calibration_crc32=CRC))
    assert isinstance(message, binary.CloudMessage)
    cloud = read(made.cloud(message, FRAME), made.CLOUD)
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "label"]
    assert cloud.width * cloud.point_step == cloud.row_step == len(cloud.data)
    layout = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "formats": [{7: "<f4", 6: "<u4"}[field.datatype] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    points = cloud.data.view(layout)
    assert (len(points) > 0) == (depth_mm > 0)
    for axis, name in enumerate("xyz"):
        np.testing.assert_allclose(points[name], message.points_mm[:, axis] / 1000, rtol=1e-6)
    np.testing.assert_array_equal(points["label"], message.labels)


def touch(**values: float | None) -> TouchNumbers:
    return TouchNumbers(
        seq=7, t_ns=1, touch=values, touch_sigma=dict.fromkeys(values, 0.1), wall_ns=PRESS.wall_ns
    )


def test_a_wrench_is_what_was_labelled_and_is_known() -> None:
    labelled = touch(depth_mm=1.0, force_z_n=-2.5, torque_x_nmm=40.0)
    payload = made.wrench(labelled, FRAME)
    assert payload is not None
    wrench = read(payload, made.WRENCH)
    assert (wrench.header.frame_id, stamp_ns(wrench)) == (FRAME, PRESS.wall_ns)
    force, torque = wrench.wrench.force, wrench.wrench.torque
    assert (force.x, force.y, force.z) == (0.0, 0.0, -2.5)
    assert (torque.x, torque.y, torque.z) == pytest.approx((0.04, 0.0, 0.0))
    for unknown in (
        touch(depth_mm=1.0),
        touch(force_z_n=None),
        touch(force_z_n=1.0, force_x_n=None),
        touch(),
    ):
        assert made.wrench(unknown, FRAME) is None


def test_transforms() -> None:
    pose = Pose(1, 100.0, -20.0, 300.0, 0.5, -0.5, 0.5, -0.5)
    seven = (pose.x_mm, pose.y_mm, pose.z_mm, pose.qw, pose.qx, pose.qy, pose.qz)
    far = made.Transform(seven, 2**63, "b", "c")
    found = read(
        made.transforms([made.Transform(seven, 17, "a_base", "a_flange"), far]), made.TRANSFORMS
    )
    one, late = found.transforms
    assert (one.header.frame_id, one.child_frame_id, stamp_ns(one)) == ("a_base", "a_flange", 17)
    at, turn = one.transform.translation, one.transform.rotation
    assert (at.x, at.y, at.z) == pytest.approx((0.1, -0.02, 0.3))
    assert (turn.x, turn.y, turn.z, turn.w) == (-0.5, 0.5, -0.5, 0.5)
    assert late.header.stamp.sec == 2**31 - 1


def test_a_diagnosis() -> None:
    known = decode_health(health())
    found = read(
        made.diagnostics(9, [diagnosis("left", "online", known), diagnosis("right", "", None)]),
        made.DIAGNOSTICS,
    )
    left, right = found.status
    assert (left.name, left.hardware_id, left.message) == ("tacshade: left", "left", "online: torn")
    values = {value.key: value.value for value in left.values}
    assert values["frames_invalid"] == "1"
    assert float(values["latency_p99_ms"]) == 20.0
    assert values["invalid_reason_code"] == "torn"
    assert (right.message, right.values) == ("unknown", [])


@pytest.mark.parametrize(
    ("state", "level"),
    [("online", 0), ("degraded", 1), ("offline", 2), ("stopped", 3), ("", 3)],
)
def test_a_level_is_the_state_s(state: Any, level: int) -> None:
    assert diagnosis("left", state, None).level == level
