"""A sensor's messages as ROS 2's: lengths in metres (REP 103), frames of the sensor's own, stamps in Unix time.

Of no particular ROS: whoever calls brings the message types, so that they can be made where ROS is not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from tacshade_edge.protocol.wire import CloudMessage, HeightMessage

M_PER_MM = 0.001
FLOAT32, UINT16 = 7, 4  # of sensor_msgs/PointField
POINT = np.dtype([("xyz", "<f4", 3), ("object", "<u2")])


class Ros(Protocol):
    """The message types of a ROS.

    Attributes
    ----------
    octets : callable
        Bytes as a ``uint8[]`` field takes them.
    """

    @property
    def octets(self) -> Callable[[bytes], Any]:
        """Of bytes."""

    def make(self, name: str, /, **fields: Any) -> Any:
        """A message of a type such as ``sensor_msgs/msg/Image``."""


def image(ros: Ros, message: HeightMessage, sensor_id: str) -> Any:
    """``sensor_msgs/Image``, 32FC1: h of each cell in m, positive inwards; NaN outside the disc."""
    rows, cols = message.height_mm.shape
    return ros.make(
        "sensor_msgs/msg/Image",
        header=header(ros, message.wall_ns, f"{sensor_id}/sensor"),
        height=rows,
        width=cols,
        encoding="32FC1",
        is_bigendian=0,
        step=4 * cols,
        data=ros.octets((message.height_mm * np.float32(M_PER_MM)).astype("<f4").tobytes()),
    )


def cloud(ros: Ros, message: CloudMessage, sensor_id: str) -> Any:
    """``sensor_msgs/PointCloud2``: x, y, z in m, and the number of each point's object, from 1."""
    points = np.empty(len(message.labels), POINT)
    points["xyz"], points["object"] = message.points_mm * np.float32(M_PER_MM), message.labels
    layout = (("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("object", 12, UINT16))
    return ros.make(
        "sensor_msgs/msg/PointCloud2",
        header=header(ros, message.wall_ns, f"{sensor_id}/sensor"),
        height=1,
        width=len(points),
        fields=[
            ros.make("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=datatype, count=1)
            for name, offset, datatype in layout
        ],
        is_bigendian=False,
        point_step=POINT.itemsize,
        row_step=POINT.itemsize * len(points),
        data=ros.octets(points.tobytes()),
        is_dense=True,
    )


def transform(ros: Ros, values: tuple[float, ...], wall_ns: int, parent: str, child: str) -> Any:
    """``tf2_msgs/TFMessage`` of one transform: x, y, z in mm, quaternion w, x, y, z."""
    x, y, z, qw, qx, qy, qz = values
    return ros.make(
        "tf2_msgs/msg/TFMessage",
        transforms=[
            ros.make(
                "geometry_msgs/msg/TransformStamped",
                header=header(ros, wall_ns, parent),
                child_frame_id=child,
                transform=ros.make(
                    "geometry_msgs/msg/Transform",
                    translation=ros.make("geometry_msgs/msg/Vector3", x=x * M_PER_MM, y=y * M_PER_MM, z=z * M_PER_MM),
                    rotation=ros.make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
                ),
            )
        ],
    )


def header(ros: Ros, wall_ns: int, frame_id: str) -> Any:
    """``std_msgs/Header``."""
    sec, nanosec = divmod(wall_ns, 1_000_000_000)
    stamp = ros.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return ros.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)
