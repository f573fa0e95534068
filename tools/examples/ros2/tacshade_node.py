"""An example node: hands on an MQTT broker as ROS 2 topics; see docs/how-to/integrations.md for what of it was run.

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

from tacshade_edge.devices.mqtt.client import BrokerAddress
from tacshade_edge.devices.mqtt.follower import Follower
from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol import wire
from tacshade_edge.protocol.received import decode_info, decode_touch
from tools.examples.ros2 import ros_messages

POLL_S = 0.1


class Ros:
    """The message types of the ROS that runs this."""

    @staticmethod
    def octets(data: bytes) -> array.array[int]:
        """As rclpy takes them without looking at each."""
        return array.array("B", data)

    @staticmethod
    def make(name: str, /, **fields: Any) -> Any:
        """A message."""
        return get_message(name)(**fields)


def main() -> None:
    """Until Ctrl-C. What no node subscribes to is not asked of the hand."""
    (host, _, port), sensor_id = sys.argv[1].partition(":"), sys.argv[2]
    logging.basicConfig(level=logging.INFO)
    rclpy.init()
    base, name = f"tacshade/{sensor_id}", sensor_id.replace("-", "_")
    node = rclpy.create_node(f"tacshade_{name}")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    ros = Ros()
    streams = {
        f"{base}/height": node.create_publisher(
            get_message("sensor_msgs/msg/Image"), f"/tacshade/{name}/height", qos_profile_sensor_data
        ),
        f"{base}/cloud": node.create_publisher(
            get_message("sensor_msgs/msg/PointCloud2"), f"/tacshade/{name}/cloud", qos_profile_sensor_data
        ),
    }
    wrenches = node.create_publisher(
        get_message("geometry_msgs/msg/WrenchStamped"), f"/tacshade/{name}/wrench", qos_profile_sensor_data
    )
    surfaces = node.create_publisher(
        get_message("geometry_msgs/msg/PoseStamped"), f"/tacshade/{name}/surface", qos_profile_sensor_data
    )
    skin_radius_mm = 0.0
    moving = node.create_publisher(get_message("tf2_msgs/msg/TFMessage"), "/tf", 10)
    fixed = node.create_publisher(get_message("tf2_msgs/msg/TFMessage"), "/tf_static", latched)

    def hear(topic: str, payload: bytes, _retained: bool) -> None:
        nonlocal skin_radius_mm
        try:
            if topic.endswith("/info"):
                if geometry := decode_info(payload).geometry:
                    skin_radius_mm = geometry.skin_radius_mm
                    placed = geometry.flange_T_sensor, time.time_ns(), f"{sensor_id}/flange", f"{sensor_id}/sensor"
                    fixed.publish(ros_messages.transform(ros, *placed))
                return
            if topic.endswith("/touch"):
                touch = decode_touch(payload)
                if wrench := ros_messages.wrench(ros, touch, sensor_id):
                    wrenches.publish(wrench)
                if skin_radius_mm and (surface := ros_messages.surface(ros, touch, skin_radius_mm, sensor_id)):
                    surfaces.publish(surface)
                return
            message = wire.decode(payload)
        except DecodeError as error:
            node.get_logger().warning(f"{topic}: {error}")
            return
        if isinstance(message, wire.CloudMessage):
            streams[topic].publish(ros_messages.cloud(ros, message, sensor_id))
        elif isinstance(message, wire.HeightMessage):
            streams[topic].publish(ros_messages.image(ros, message, sensor_id))
        if (p := message.pose) is not None:
            values = (p.x_mm, p.y_mm, p.z_mm, p.qw, p.qx, p.qy, p.qz)
            moved = values, message.wall_ns, f"{sensor_id}/base", f"{sensor_id}/flange"
            moving.publish(ros_messages.transform(ros, *moved))

    address = BrokerAddress(host=host, port=int(port or 1883), username=None, password=None, tls_ca=None)
    follower = Follower(address, hear)
    follower.start()
    try:
        while rclpy.ok():
            wanted = {topic for topic, publisher in streams.items() if publisher.get_subscription_count()}
            if wrenches.get_subscription_count() or surfaces.get_subscription_count():
                wanted.add(f"{base}/touch")
            follower.follow({f"{base}/info", *wanted})
            rclpy.spin_once(node, timeout_sec=POLL_S)
    except KeyboardInterrupt:
        pass
    finally:
        follower.stop()
        node.destroy_node()


if __name__ == "__main__":
    main()
