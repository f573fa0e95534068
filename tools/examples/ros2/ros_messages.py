"""Convert a sensor's messages to ROS 2: lengths in metres (REP 103), frames named after the sensor,
Unix time stamps.

The module imports no ROS: the caller supplies the message types,
so it can make messages without ROS.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from tacshade_client import CloudMessage, HeightMessage, TouchNumbers
from tacshade_client.rigid import shift, turn

M_PER_MM = 0.001
FLOAT32, UINT16 = 7, 4  # types of sensor_msgs/PointField
FORCE = ("force_x_n", "force_y_n", "force_z_n")
TORQUE = ("torque_x_nmm", "torque_y_nmm", "torque_z_nmm")
POINT = np.dtype([("xyz", "<f4", 3), ("object", "<u2")])


class Ros(Protocol):
    """The message types of a ROS installation; `octets` converts bytes to the value
    of a ``uint8[]`` field.
    """

    @property
    def octets(self) -> Callable[[bytes], Any]:
        """The function that converts bytes."""

    def make(self, name: str, /, **fields: Any) -> Any:
        """Make a message of a type such as ``sensor_msgs/msg/Image``."""


def image(ros: Ros, message: HeightMessage, sensor_id: str) -> Any:
    """Make a ``sensor_msgs/Image``, 32FC1: h of each cell in m, positive inwards;
    NaN outside the disc, and everywhere in a frame that could not be used.
    """
    height_m = message.height_mm * np.float32(np.nan if message.invalid else M_PER_MM)
    rows, cols = message.height_mm.shape
    return ros.make(
        "sensor_msgs/msg/Image",
        header=header(ros, message.wall_ns, f"{sensor_id}/sensor"),
        height=rows,
        width=cols,
        encoding="32FC1",
        is_bigendian=0,
        step=4 * cols,
        data=ros.octets(height_m.astype("<f4").tobytes()),
    )


def cloud(ros: Ros, message: CloudMessage, sensor_id: str) -> Any:
    """Make a ``sensor_msgs/PointCloud2``: x, y, z in m, and the number of each point's object,
    from 1.
    """
    points = np.empty(len(message.labels), POINT)
    points["xyz"], points["object"] = message.points_mm * np.float32(M_PER_MM), message.labels
    layout = (("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("object", 12, UINT16))
    return ros.make(
        "sensor_msgs/msg/PointCloud2",
        header=header(ros, message.wall_ns, f"{sensor_id}/sensor"),
        height=1,
        width=len(points),
        fields=[
            ros.make(
                "sensor_msgs/msg/PointField", name=name, offset=offset, datatype=datatype, count=1
            )
            for name, offset, datatype in layout
        ],
        is_bigendian=False,
        point_step=POINT.itemsize,
        row_step=POINT.itemsize * len(points),
        data=ros.octets(points.tobytes()),
        is_dense=True,
    )


def transform(ros: Ros, values: tuple[float, ...], wall_ns: int, parent: str, child: str) -> Any:
    """Make a ``tf2_msgs/TFMessage`` with one transform, given as x, y, z in mm and quaternion w, x,
    y, z.
    """
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
                    translation=_vector(ros, [v * M_PER_MM for v in (x, y, z)]),
                    rotation=ros.make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
                ),
            )
        ],
    )


def wrench(ros: Ros, touch: TouchNumbers, sensor_id: str) -> Any | None:
    """Make a ``geometry_msgs/WrenchStamped``: force in N, torque in N·m, 0 in unlabelled axes;
    None if unknown.
    """
    if (values := _known(touch, (*FORCE, *TORQUE), needed=())) is None:
        return None
    force, torque = values[:3], [value * M_PER_MM for value in values[3:]]
    return ros.make(
        "geometry_msgs/msg/WrenchStamped",
        header=header(ros, touch.wall_ns, f"{sensor_id}/sensor"),
        wrench=ros.make(
            "geometry_msgs/msg/Wrench", force=_vector(ros, force), torque=_vector(ros, torque)
        ),
    )


def surface(ros: Ros, touch: TouchNumbers, skin_radius_mm: float, sensor_id: str) -> Any | None:
    """Make a ``geometry_msgs/PoseStamped`` of the touched surface from depth, tilt and twist;
    None if unknown.

    The surface lies `depth_mm` below the undeformed skin at (x, y), turned by the twist about z,
    then tilted about x, then y. Twist, x and y are 0 if the labels lack them. The radius of a pad
    is infinite.
    """
    names = ("depth_mm", "tilt_x_deg", "tilt_y_deg", "twist_deg", "x_mm", "y_mm")
    if (values := _known(touch, names, needed=names[:3])) is None:
        return None
    depth, x, y = values[0], values[4], values[5]
    tilt_x, tilt_y, twist = (math.radians(angle) for angle in values[1:4])
    beside = max(0.0, skin_radius_mm**2 - x**2 - y**2)
    z = (0.0 if math.isinf(skin_radius_mm) else math.sqrt(beside)) - depth
    *place, qw, qx, qy, qz = (
        shift(x, y, z) @ turn((0, tilt_y, 0)) @ turn((tilt_x, 0, 0)) @ turn((0, 0, twist))
    ).seven()
    return ros.make(
        "geometry_msgs/msg/PoseStamped",
        header=header(ros, touch.wall_ns, f"{sensor_id}/sensor"),
        pose=ros.make(
            "geometry_msgs/msg/Pose",
            position=ros.make("geometry_msgs/msg/Point", **_xyz([v * M_PER_MM for v in place])),
            orientation=ros.make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
        ),
    )


def _known(touch: TouchNumbers, names: Sequence[str], needed: Sequence[str]) -> list[float] | None:
    """Read numbers of a touch, 0 for unlabelled ones;
    None if one is unknown or a needed one was not labelled.
    """
    given = touch.touch or {}
    values = [given.get(name, 0.0) for name in names]
    known = [value for value in values if value is not None]
    enough = all(name in given for name in needed) and any(name in given for name in names)
    return known if enough and len(known) == len(values) else None


def _vector(ros: Ros, values: Sequence[float]) -> Any:
    return ros.make("geometry_msgs/msg/Vector3", **_xyz(values))


def _xyz(values: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", values, strict=True))


def header(ros: Ros, wall_ns: int, frame_id: str) -> Any:
    """Make a ``std_msgs/Header``."""
    sec, nanosec = divmod(wall_ns, 1_000_000_000)
    stamp = ros.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return ros.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)
