"""`listen` through a real broker that goes away, comes back and refuses,
and what waits for a slow reader.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tacshade_client as tc

from support.mqtt_rig import Broker, Subscriber, free_port
from support.patience import patience, wait_until
from support.published_sensor import CRC, PublishedSensor, bump, unmeasured
from tacshade_edge.mqtt.listener import WAITING_MAX
from tacshade_edge.wire import binary, messages

pytestmark = pytest.mark.broker
HEIGHT = binary.encode_height(bump(7, 2.0, 236.0, 328.0, step_px=8), calibration_crc32=CRC)


def contact(seq: int) -> bytes:
    return messages.encode_contact(bump(seq, 2.0, 236.0, 328.0, step_px=8), fps=60.0)


def taken(listener: tc.Listener) -> tc.Message:
    message = listener.get(patience(10))
    assert message is not None
    return message


def test_messages_of_one_sensor_come_decoded(broker: Broker) -> None:
    where = f"127.0.0.1:{broker.port}"
    with (
        Subscriber(broker.port, "none") as sender,
        tc.listen(where, "left", ["height", "state", "status/+"]) as heard,
    ):
        sender.publish("tacshade/left/state", b"online", retain=True)
        sender.publish("tacshade/right/height", HEIGHT)
        sender.publish("tacshade/left/height", b"\xff\x00 damaged")
        sender.publish("tacshade/left/height", HEIGHT)
        sender.publish("tacshade/left/status/camera", messages.encode_status("streaming"))
        found = {message.part: message for message in (taken(heard) for _ in range(3))}
        assert found["state"].value == "online"
        assert not found["state"].retained
        assert float(np.nanmax(found["height"].value.height_mm)) == pytest.approx(2.0, abs=0.01)
        assert found["status/camera"].value.state == "streaming"
        assert heard.refused + heard.passed_over == 1
        assert heard.get(0.0) is None
        sender.publish("tacshade/left/state", b"degraded")
        assert heard.get(math.inf) is not None
    with tc.listen(where, "+", ["state"]) as heard:
        kept = next(heard)
        assert (kept.name, kept.part, kept.value, kept.retained) == (
            "left",
            "state",
            "online",
            True,
        )


def test_a_touch_of_unknown_depth_comes_through_the_broker(broker: Broker) -> None:
    with (
        PublishedSensor(broker.port, "left") as sensor,
        tc.listen(f"127.0.0.1:{broker.port}", "left", ["height", "contact"]) as heard,
    ):
        sensor.show(unmeasured(7))
        found = {message.part: message.value for message in (taken(heard) for _ in range(2))}
    contact, height = found["contact"], found["height"]
    assert (contact.contact, contact.touched, contact.depth_max_mm) == (0, 1, None)
    assert contact.degraded_code == "touch_unmeasured"
    assert (height.contact, height.touched, height.degraded) == (False, True, True)
    assert float(np.nanmax(height.height_mm)) == 0


def test_a_silence_from_the_start_names_the_sensors_that_are_there_once(
    broker: Broker, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tacshade_edge.mqtt.listener.SILENT_S", 0.2)
    with (
        Subscriber(broker.port, "none") as sender,
        tc.listen(f"127.0.0.1:{broker.port}", "lfet") as heard,
    ):
        sender.publish("tacshade/left/state", b"online", retain=True)
        sender.publish("tacshade/right/state", b"offline", retain=True)
        wait_until(lambda: heard.get(0.1) is None and caplog.records, 10, "the line")
        sender.publish("tacshade/lfet/height", HEIGHT)
        assert taken(heard).name == "lfet"
        assert heard.get(0.5) is None
    (line,) = (record.getMessage() for record in caplog.records)
    assert line.endswith(
        "no message on tacshade/lfet/height so far; there are left (online), right (offline)"
    )


def test_of_contacts_the_newest_waits_and_of_states_every_one(broker: Broker) -> None:
    with (
        Subscriber(broker.port, "none") as sender,
        tc.listen(f"localhost:{broker.port}", "left", ["contact", "state"]) as heard,
    ):
        for seq in range(40):
            sender.publish("tacshade/left/contact", contact(seq))
            sender.publish("tacshade/left/state", b"degraded" if seq % 2 else b"online")
        wait_until(lambda: heard.passed_over == 39, 10, "40 contacts")
        states = [taken(heard) for _ in range(41)]
        newest = [message.value.seq for message in states if message.part == "contact"]
        assert newest == [39]
        assert [message.value for message in states if message.part == "state"] == [
            "online",
            "degraded",
        ] * 20
        for _ in range(WAITING_MAX + 10):
            sender.publish("tacshade/left/state", b"online")
        wait_until(lambda: heard.dropped == 10, 20, "the oldest are dropped")


def test_it_comes_back_with_its_broker_and_its_topics(
    broker: Broker, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    with tc.listen(f"127.0.0.1:{broker.port}", "left", ["height"]) as heard:
        heard.follow(["contact"])
        broker.kill()
        wait_until(lambda: "connection lost" in caplog.text, 10, "the loss is logged")
        broker.start()
        with Subscriber(broker.port, "none") as sender:
            seen: list[tc.Message] = []

            def came() -> bool:
                sender.publish("tacshade/left/height", HEIGHT)
                sender.publish("tacshade/left/contact", contact(5))
                if (message := heard.get(0.1)) is not None:
                    seen.append(message)
                return bool(seen)

            wait_until(came, 20, "a contact after the broker's restart")
        assert seen[0].part == "contact"
        wait_until(lambda: "connected again" in caplog.text, 10, "the return is logged")


def test_close_ends_a_loop_in_another_thread(broker: Broker) -> None:
    heard = tc.listen(f"127.0.0.1:{broker.port}", "hand/left", ["objects"])
    got: list[Any] = []
    reader = threading.Thread(target=lambda: got.extend(heard))
    reader.start()
    heard.close()
    heard.close()
    reader.join(patience(10))
    assert not reader.is_alive()
    assert got == []


def test_with_tls_and_a_user(tmp_path: Path) -> None:
    with Broker(tmp_path, users={"eve": "secret"}, tls=True) as broker:
        where = f"localhost:{broker.port}"
        with pytest.raises(tc.DeviceError, match="rejects the connection: "):
            tc.listen(where, "left", username="eve", password="wrong", ca_file=broker.ca)
        with tc.listen(
            where, "left", ["state"], username="eve", password="secret", ca_file=broker.ca
        ) as heard:
            assert heard.get(0.0) is None
        with pytest.raises(tc.DeviceError):
            tc.listen(where, "left")


def test_an_absent_broker_is_one_line_at_once() -> None:
    began_s = time.monotonic()
    with pytest.raises(
        tc.DeviceError, match=r"refused; expected a broker that serves topics under tacshade/left/$"
    ):
        tc.listen(f"127.0.0.1:{free_port()}", "left")
    assert time.monotonic() - began_s < patience(5)


@pytest.mark.parametrize(
    ("broker_text", "name", "topics", "other", "found"),
    [
        ("host:70000", "left", ["height"], {}, "broker: "),
        ("host", "hand/", ["height"], {}, "name: "),
        ("host", "a/b", ["height"], {}, "name: "),
        ("host", "left", "height", {}, "topics: "),
        ("host", "left", ["/height"], {}, "topics: "),
        ("host", "left", ["height"], {"password": "x"}, "password: "),
        ("host", "left", ["height"], {"ca_file": "/none.pem"}, "expected a PEM file"),
    ],
)
def test_arguments_that_cannot_work(
    broker_text: str, name: str, topics: list[str], other: dict[str, str], found: str
) -> None:
    with pytest.raises(tc.ConfigError, match=found):
        tc.listen(broker_text, name, topics, **other)
