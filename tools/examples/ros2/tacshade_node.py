"""An example node that publishes a sensor on an MQTT broker as ROS 2 topics;
the node itself never ran.

source /opt/ros/jazzy/setup.bash
python3 -m tools.examples.ros2.tacshade_node localhost:1883 left-index
"""

from __future__ import annotations

import array
import logging
import sys
import time
from typing import Any

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rosidl_runtime_py.utilities import get_message
from tacshade_client import CloudMessage, HeightMessage, Info, Message, TouchNumbers, listen

from tools.examples.ros2 import ros_messages

POLL_S = 0.1


class Ros:
    """The message types of the installed ROS."""

    @staticmethod
    def octets(data: bytes) -> array.array[int]:
        """Convert bytes to a type that rclpy accepts without checking each element."""
        return array.array("B", data)

    @staticmethod
    def make(name: str, /, **fields: Any) -> Any:
        """Make a message."""
        return get_message(name)(**fields)


def main() -> None:
    """Run until Ctrl-C; subscribe over MQTT only to topics that have a ROS subscriber."""
    broker, sensor_id = sys.argv[1:]
    logging.basicConfig(level=logging.INFO)
    rclpy.init()
    name = sensor_id.replace("-", "_")
    node = rclpy.create_node(f"tacshade_{name}")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    ros = Ros()
    streams = {
        "height": node.create_publisher(
            get_message("sensor_msgs/msg/Image"),
            f"/tacshade/{name}/height",
            qos_profile_sensor_data,
        ),
        "cloud": node.create_publisher(
            get_message("sensor_msgs/msg/PointCloud2"),
            f"/tacshade/{name}/cloud",
            qos_profile_sensor_data,
        ),
    }
    wrenches = node.create_publisher(
        get_message("geometry_msgs/msg/WrenchStamped"),
        f"/tacshade/{name}/wrench",
        qos_profile_sensor_data,
    )
    surfaces = node.create_publisher(
        get_message("geometry_msgs/msg/PoseStamped"),
        f"/tacshade/{name}/surface",
        qos_profile_sensor_data,
    )
    skin_radius_mm = 0.0
    moving = node.create_publisher(get_message("tf2_msgs/msg/TFMessage"), "/tf", 10)
    fixed = node.create_publisher(get_message("tf2_msgs/msg/TFMessage"), "/tf_static", latched)

    def publish(message: Message) -> None:
        nonlocal skin_radius_mm
        match message.value:
            case Info(geometry=geometry) if geometry is not None:
                skin_radius_mm = geometry.geometry.skin_radius_mm
                placed = (
                    geometry.flange_T_sensor,
                    time.time_ns(),
                    f"{sensor_id}/flange",
                    f"{sensor_id}/sensor",
                )
                fixed.publish(ros_messages.transform(ros, *placed))
            case TouchNumbers() as touch:
                if wrench := ros_messages.wrench(ros, touch, sensor_id):
                    wrenches.publish(wrench)
                if skin_radius_mm and (
                    surface := ros_messages.surface(ros, touch, skin_radius_mm, sensor_id)
                ):
                    surfaces.publish(surface)
            case HeightMessage() as height:
                streams["height"].publish(ros_messages.image(ros, height, sensor_id))
                move(height)
            case CloudMessage() as cloud:
                streams["cloud"].publish(ros_messages.cloud(ros, cloud, sensor_id))
                move(cloud)

    def move(message: HeightMessage | CloudMessage) -> None:
        if (p := message.pose) is not None:
            values = (p.x_mm, p.y_mm, p.z_mm, p.qw, p.qx, p.qy, p.qz)
            moved = values, message.wall_ns, f"{sensor_id}/base", f"{sensor_id}/flange"
            moving.publish(ros_messages.transform(ros, *moved))

    try:
        with listen(broker, sensor_id, ["info"]) as messages:
            while rclpy.ok():
                wanted = {
                    topic
                    for topic, publisher in streams.items()
                    if publisher.get_subscription_count()
                }
                if wrenches.get_subscription_count() or surfaces.get_subscription_count():
                    wanted.add("touch")
                messages.follow({"info", *wanted})
                if (message := messages.get(POLL_S)) is not None:
                    publish(message)
                rclpy.spin_once(node, timeout_sec=0)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()


if __name__ == "__main__":
    main()
