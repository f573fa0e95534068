"""The files of config/fleet with real brokers: what goes up, what does not,
and what a cut link costs.
"""

from __future__ import annotations

import socket
import ssl
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest
from paho.mqtt.client import MQTTMessage

from support.fleet import CentralClient, ConfiguredBroker, board, central, people_port
from support.mqtt_rig import Subscriber
from support.patience import patience, wait_until

pytestmark = [pytest.mark.broker, pytest.mark.slow]


@dataclass
class Two:
    """Two boards and a central broker."""

    folder: Path
    central: ConfiguredBroker
    at: dict[str, Subscriber]
    heard: list[MQTTMessage]

    def of(self, topic: str) -> list[bytes]:
        return [message.payload for message in list(self.heard) if message.topic == topic]

    def wait_for(self, topic: str, payload: bytes, seconds: float = 60) -> None:
        wait_until(
            lambda: payload in self.of(topic), seconds, f"{payload!r} of {topic}: {self.of(topic)}"
        )


@pytest.fixture
def two(tmp_path: Path) -> Iterator[Two]:
    with ExitStack() as stack:
        middle = stack.enter_context(central(tmp_path))
        at = {}
        for name in ("left", "right"):
            broker = stack.enter_context(board(tmp_path, name, middle.port))
            at[name] = stack.enter_context(Subscriber(broker.port, "nothing"))
        heard: list[MQTTMessage] = []
        stack.enter_context(
            CentralClient(tmp_path, people_port(tmp_path), heard.append, None, "tacshade/#")
        )
        made = Two(tmp_path, middle, at, heard)
        for name in at:
            made.wait_for(f"tacshade/{name}/bridge", b"1")
        yield made


def test_summaries_go_up_frames_do_not_and_no_board_writes_as_another(two: Two) -> None:
    left = two.at["left"]
    sent = (
        "state",
        "info",
        "status/camera",
        "event/slip",
        "map/revision",
        "contact",
        "touch",
        "health",
    )
    for topic in (*sent, "height", "preview", "map/cloud", "req/profile"):
        left.publish(f"tacshade/left/{topic}", topic.encode(), retain=topic == "state")
    left.publish(
        "tacshade/right/state", b"from left"
    )  # its own broker takes it, the central one does not
    left.publish("tacshade/left/event/slip", b"the last")
    two.wait_for("tacshade/left/event/slip", b"the last")
    for topic in sent:
        two.wait_for(f"tacshade/left/{topic}", topic.encode())
    got = {message.topic for message in two.heard if message.topic.startswith("tacshade/left/")}
    assert got == {f"tacshade/left/{topic}" for topic in (*sent, "bridge")}
    with CentralClient(two.folder, two.central.port, lambda _: None, "right") as right:
        for topic in ("tacshade/left/state", "tacshade/hand/left/state", "tacshade/right/state"):
            right.publish(topic, b"from right", 1).wait_for_publish(patience(10))
    two.wait_for("tacshade/right/state", b"from right")
    assert b"from right" not in two.of("tacshade/left/state") + two.of("tacshade/hand/left/state")
    assert b"from left" not in two.of("tacshade/right/state")
    context = ssl.create_default_context(cafile=two.folder / "ca.pem")
    with (
        socket.create_connection(("127.0.0.1", two.central.port), timeout=patience(10)) as raw,
        pytest.raises(ssl.SSLError, match="certificate required"),
        context.wrap_socket(raw, server_hostname="127.0.0.1") as stranger,
    ):
        stranger.recv(1)


def test_events_outlast_a_central_broker_that_stalls_and_one_that_forgets_everything(
    two: Two,
) -> None:
    left = two.at["left"]
    left.publish("tacshade/left/state", b"online", retain=True)
    two.wait_for("tacshade/left/state", b"online")

    def send(first: int) -> None:
        for k in range(first, first + 500):
            left.publish("tacshade/left/event/slip", str(k).encode())

    two.central.stall()
    send(0)
    two.central.resume()
    two.wait_for("tacshade/left/event/slip", b"499")
    two.central.stop()
    send(500)
    two.central.start()
    two.wait_for("tacshade/left/event/slip", b"999")
    assert sorted(set(map(int, two.of("tacshade/left/event/slip")))) == list(range(1000))
    two.central.kill()
    (two.folder / "mosquitto.db").unlink()
    two.heard.clear()
    two.central.start()
    two.wait_for(
        "tacshade/left/state", b"online"
    )  # the board retains it, and sends it to a broker that knows nothing
