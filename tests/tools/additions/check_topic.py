"""What a new topic of each frame does without another line: need, payload, decoding."""

from __future__ import annotations

from dataclasses import replace

import pytest
import tacshade_client

from support.published_sensor import bump, calibration
from tacshade_edge.errors import DecodeError
from tacshade_edge.mqtt.outgoing import CONTENT_TYPES
from tacshade_edge.mqtt.publishing import Publisher
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.types import Frame, Need, Reconstruction
from tacshade_edge.wire.topics import OF_SENSORS


def offered(result: Reconstruction, *wanted: str) -> dict[str, bytes]:
    """What a frame puts into the outgoing port, and that it needs depth for it."""
    offers: dict[str, bytes] = {}
    publisher = Publisher(
        lambda stream, payload, seq: offers.update({stream: payload}),
        lambda topic, payload: None,
        lambda seq, outcome: None,
        lambda stream: stream in wanted,
    )
    assert (Need.DEPTH in publisher.need()) is bool(wanted)
    image = calibration().reference_grey
    publisher.see(FrameResult(Frame(result.seq, 1, 2, image), calibration(), result))
    return offers


def test_a_subscriber_gets_it_and_understands_it() -> None:
    pressed = bump(7, 2.0, 236.0, 328.0, step_px=8)
    payload = offered(pressed, "strength")["strength"]
    message = tacshade_client.decode_message("tacshade/left/strength", payload)
    assert (message.value.seq, message.value.strength) == (7, 2.0)
    decoded = OF_SENSORS["strength"].decode("strength", payload)
    assert (decoded.seq, decoded.strength) == (7, 2.0)
    assert OF_SENSORS["strength"].newest_wins
    assert CONTENT_TYPES["strength"] == "application/json"
    assert "strength" not in offered(pressed)
    assert "strength" not in offered(replace(pressed, contact=False), "strength")


def test_a_value_that_no_daemon_sends_is_refused() -> None:
    with pytest.raises(DecodeError, match=r"^strength: "):
        tacshade_client.decode_message("tacshade/left/strength", b'{"seq": 1, "strength": -1}')
