"""The ROS 2 messages of tools/ros2, through another's definitions and serialisation (CDR):
rosbags, without a ROS.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from tacshade_client import CloudMessage, HeightMessage, TouchNumbers, decode

from support.published_sensor import CRC, bump
from tacshade_edge.calibration.indenters import Indenter, place
from tacshade_edge.rigid import from_seven
from tacshade_edge.types import U8
from tacshade_edge.wire import binary
from tools.examples.ros2 import ros_messages

PRESS = bump(7, 2.0, 236.0, 328.0, step_px=4)


@cache
def store() -> Any:
    typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY)


class Ros:
    """The types of ROS 2 Jazzy."""

    @staticmethod
    def octets(data: bytes) -> U8:
        return np.frombuffer(data, np.uint8)

    @staticmethod
    def make(name: str, /, **fields: Any) -> Any:
        return store().types[name](**fields)


def there_and_back(message: Any) -> Any:
    return store().deserialize_cdr(
        store().serialize_cdr(message, message.__msgtype__), message.__msgtype__
    )


def test_an_image() -> None:
    height = decode(binary.encode_height(PRESS, calibration_crc32=CRC))
    assert isinstance(height, HeightMessage)
    image = there_and_back(ros_messages.image(Ros(), height, "left-index"))
    assert (image.encoding, image.height, image.width, image.step, image.is_bigendian) == (
        "32FC1",
        120,
        160,
        640,
        0,
    )
    assert image.header.frame_id == "left-index/sensor"
    assert image.header.stamp.sec * 10**9 + image.header.stamp.nanosec == PRESS.wall_ns
    np.testing.assert_allclose(
        image.data.view("<f4").reshape(120, 160), height.height_mm / 1000, rtol=1e-6
    )


def test_a_cloud() -> None:
    message = decode(binary.encode_cloud(PRESS, calibration_crc32=CRC))
    assert isinstance(message, CloudMessage)
    cloud = there_and_back(ros_messages.cloud(Ros(), message, "left-index"))
    assert cloud.height * cloud.width * cloud.point_step == cloud.row_step == len(cloud.data)
    layout = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "formats": [{7: "<f4", 4: "<u2"}[field.datatype] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    points = cloud.data.view(layout)
    for axis, name in enumerate("xyz"):
        np.testing.assert_allclose(points[name], message.points_mm[:, axis] / 1000, rtol=1e-6)
    np.testing.assert_array_equal(points["object"], message.labels)


def touch(**values: float | None) -> TouchNumbers:
    return TouchNumbers(
        seq=7, t_ns=1, touch=values, touch_sigma=dict.fromkeys(values, 0.1), wall_ns=PRESS.wall_ns
    )


def test_a_wrench_is_what_was_labelled_and_is_known() -> None:
    labelled = touch(depth_mm=1.0, force_z_n=-2.5, torque_x_nmm=40.0)
    wrench = there_and_back(ros_messages.wrench(Ros(), labelled, "left-index"))
    assert wrench.header.frame_id == "left-index/sensor"
    assert wrench.header.stamp.sec * 10**9 + wrench.header.stamp.nanosec == PRESS.wall_ns
    force, torque = wrench.wrench.force, wrench.wrench.torque
    assert (force.x, force.y, force.z) == (0.0, 0.0, -2.5)
    assert (torque.x, torque.y, torque.z) == pytest.approx((0.04, 0.0, 0.0))
    for unknown in (
        touch(depth_mm=1.0),
        touch(force_z_n=None),
        touch(force_z_n=1.0, force_x_n=None),
        touch(),
    ):
        assert ros_messages.wrench(Ros(), unknown, "left-index") is None


def test_a_surface_lies_below_the_skin_and_is_tilted() -> None:
    known = touch(
        depth_mm=2.0, tilt_x_deg=30.0, tilt_y_deg=-20.0, twist_deg=10.0, x_mm=12.0, y_mm=0.0
    )
    surface = there_and_back(ros_messages.surface(Ros(), known, 20.0, "left-index"))
    at, turn = surface.pose.position, surface.pose.orientation
    assert (at.x, at.y, at.z) == pytest.approx((0.012, 0.0, 0.014))
    found = from_seven((0.0, 0.0, 0.0, turn.w, turn.x, turn.y, turn.z)).rotation
    axes = place(
        Indenter("axes", np.eye(3)[None]), 20.0, 12.0, 0.0, 2.0, 10.0, 30.0, -20.0
    )  # as PRESSES.csv says
    np.testing.assert_allclose(
        np.diff(found.T, axis=0), np.diff(axes.triangles_mm[0], axis=0), atol=1e-12
    )
    assert there_and_back(
        ros_messages.surface(Ros(), touch(depth_mm=2.0, tilt_x_deg=0.0, tilt_y_deg=0.0), 20.0, "a")
    )
    for unknown in (
        touch(depth_mm=2.0),
        touch(depth_mm=2.0, tilt_x_deg=0.0, tilt_y_deg=0.0, twist_deg=None),
        touch(),
    ):
        assert ros_messages.surface(Ros(), unknown, 20.0, "left-index") is None
