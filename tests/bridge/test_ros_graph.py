"""Names in ROS's graph: the examples of rmw_zenoh's design document, byte for byte, and Zenoh's own
serialiser.
"""

from __future__ import annotations

import struct

import pytest

pytest.importorskip("xxhash", reason="the extra ros2 is not installed")
ext = pytest.importorskip("zenoh.ext", reason="the extra ros2 is not installed")

from tacshade_edge.bridge import ros_graph as graph  # noqa: E402
from tacshade_edge.bridge.ros_messages import IMAGE, RosType  # noqa: E402

STRING = RosType(
    "std_msgs/msg/String",
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
)
TALKER = graph.RosNode(0, "8b20917502ee955ac4476e0266340d5c", "talker")
CHATTER = (
    "@ros2_lv/0/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/"
    f"std_msgs::msg::dds_::String_/{STRING.rihs01}/::,7:,:,:,,"
)


def test_the_examples_of_the_design_document() -> None:
    chatter = graph.RosTopic("/chatter", STRING, 7)
    assert chatter.key(0) == f"0/chatter/std_msgs::msg::dds_::String_/{STRING.rihs01}"
    assert (
        graph.RosTopic("/robot1/chatter", STRING, 7).key(0)
        == f"0/robot1/chatter/std_msgs::msg::dds_::String_/{STRING.rihs01}"
    )
    listener = graph.RosNode(0, "aac3178e146ba6f1fc6e6a4085e77f21", "listener")
    assert listener.token() == "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
    assert TALKER.publisher_token(10, chatter) == CHATTER


def test_a_latched_topic_is_transient_local() -> None:
    assert graph.RosTopic("/tf_static", STRING, 1, latched=True).qos() == ":1:,1:,:,:,,"


def test_an_attachment_is_what_zenoh_serialises() -> None:
    gid = graph.gid_of(CHATTER)
    numbers = [ext.Int64(3), ext.Int64(1_700_000_000_000_000_000)]
    expected = b"".join(bytes(ext.z_serialize(one)) for one in [*numbers, gid])
    assert graph.attachment(3, 1_700_000_000_000_000_000, gid) == expected
    assert len(expected) == 33


def test_a_gid_is_the_low_half_of_the_hash_first() -> None:
    import xxhash

    whole = xxhash.xxh3_128_intdigest(CHATTER.encode())
    low, high = struct.unpack("<QQ", graph.gid_of(CHATTER))
    assert (high << 64 | low) == whole


@pytest.mark.parametrize(
    ("sensor_id", "name"),
    [
        ("left-index", "left_index"),
        ("A--b_-c", "A_b_c"),
        ("0", "sensor_0"),
        ("-a-", "a"),
        ("__", "sensor_"),
    ],
)
def test_a_name_that_ros_accepts(sensor_id: str, name: str) -> None:
    assert graph.ros_name(sensor_id) == name


def token(domain: int, zid: str, number: int, entity: str = "MS", name: str = "%a%b") -> str:
    kind = f"sensor_msgs::msg::dds_::Image_/{IMAGE.rihs01}"
    return f"@ros2_lv/{domain}/{zid}/0/{number}/{entity}/%/%/rviz/{name}/{kind}/2::,5:,:,:,,"


def test_subscriptions_are_counted_by_their_tokens() -> None:
    listeners, key = graph.Listeners(0, "own"), graph.RosTopic("/a/b", IMAGE, 5).key(0)
    for one in (token(0, "x", 1), token(0, "y", 1), token(0, "x", 1)):
        listeners.come(one)
    assert listeners.count(key) == 2
    for other in (
        token(0, "own", 1),
        token(0, "x", 2, "MP"),
        token(0, "x", 3, name="%a"),
        token(7, "x", 4),
        "@ros2_lv/0/x",
        "@ros2_lv/0/x/0/0/NN/%/%/rviz",
        "nonsense",
    ):
        listeners.come(other)
    assert listeners.count(key) == 2
    listeners.go(token(0, "x", 1))
    listeners.go(token(0, "x", 1))
    assert listeners.count(key) == 1


def test_a_flood_of_tokens_is_bounded() -> None:
    listeners, key = graph.Listeners(0, "own"), graph.RosTopic("/a/b", IMAGE, 5).key(0)
    for number in range(graph.TOKENS_MAX + 9):
        listeners.come(token(0, "x", number))
    assert listeners.count(key) == graph.TOKENS_MAX


def test_a_network_of_another_domain_is_noticed() -> None:
    listeners = graph.Listeners(0, "own")
    assert listeners.elsewhere() == []
    listeners.come(token(5, "x", 1))
    assert listeners.elsewhere() == ["5"]
    listeners.come("@ros2_lv/0/x/0/0/NN/%/%/rviz")
    assert listeners.elsewhere() == []
