"""A topic and its payload to a value, by the names that the client offers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tacshade_client as tc
from hypothesis import given
from hypothesis import strategies as st

import tacshade_edge.sensor.geometry.disc as core
from support.published_sensor import CRC, bump, calibration, dragged, health
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.geometry.disc import Grid, disc_rays
from tacshade_edge.wire import binary, messages
from tacshade_edge.wire.codec import encode_json
from tacshade_edge.wire.hand_messages import away, encode_hand
from tacshade_edge.wire.hand_topics import HandObjects
from tacshade_edge.wire.sensor_topics import SlipEvent
from tacshade_edge.wire.topics import OF_SENSORS, _json

ROOT = Path(__file__).parents[2]
VECTORS = {
    n: json.loads((ROOT / f"tests/wire/vectors/{n}.json").read_text())
    for n in ("wire", "hand", "touch")
}
PRESS = dragged(bump(7, 2.0, 236.0, 328.0, step_px=4), 0.5, 0.25)
LOST = Reason(ReasonCode.LOST, "gone")
MAP = {
    **{
        "name": "pad",
        "revision": 3,
        "presses": 2,
        "used": 2,
        "x0_mm": 1.0,
        "y0_mm": 2.0,
        "width_mm": 3.0,
    },
    **{
        "length_mm": 4.0,
        "z_min_mm": None,
        "z_max_mm": None,
        "area_mm2": 0.0,
        "points": 0,
        "spacing_mm": 0.25,
    },
}
SENT: dict[str, bytes] = {
    "left/height": binary.encode_height(PRESS, calibration_crc32=CRC),
    "left/cloud": binary.encode_cloud(PRESS, calibration_crc32=CRC),
    "left/shear": binary.encode_shear(PRESS, calibration_crc32=CRC),
    "left/map/cloud": binary.encode_cloud(PRESS, calibration_crc32=CRC),
    "left/contact": messages.encode_contact(PRESS, fps=60.0),
    "left/touch": messages.encode_touch(PRESS),
    "left/event/slip": messages.encode_slip(PRESS, PRESS.objects[0]),
    "left/event/contact": encode_json(
        {"type": "end", "id": 3, "t_ns": 9, "start_ns": 1, "end_ns": 8, "slip": None}
    ),
    "left/event/object": messages.encode_object(
        PRESS, replace(PRESS.objects[0], name="nut_m8", probability=0.91234)
    ),
    "left/info": messages.encode_info(
        version="1", config_digest="0", profile="fast", calibration=calibration()
    ),
    "left/health": health(),
    "left/state": b"online",
    "left/status/camera": messages.encode_status("away", LOST),
    "left/instance": encode_json({"id": "x"}),
    "left/res/status": encode_json({"ok": True}),
    "left/map/revision": encode_json(MAP),
    "left/map/final": encode_json({**MAP, "folder": "/s"}),
    "left/preview": b"\xff\xd8\xff",
    "hand/left/state": b"offline",
    "hand/left/objects": encode_hand(
        HandObjects(t_ns=1, wall_ns=2, seq=3, fingers={"thumb": away(LOST)})
    ),
    "hand/left/health": encode_json(
        {"wall_ns": 1, "uptime_s": 2, "heard": {"thumb": 3}, "undecodable": 0, "mqtt": {}}
    ),
}


@pytest.mark.parametrize("topic", SENT)
def test_every_message_of_a_daemon_is_understood(topic: str) -> None:
    message = tc.decode_message(f"tacshade/{topic}", SENT[topic])
    assert f"{message.name}/{message.part}" == topic
    assert message.value


def test_what_they_hold() -> None:
    value = {
        topic: tc.decode_message(f"tacshade/{topic}", payload).value
        for topic, payload in SENT.items()
    }
    contact = value["left/contact"]
    assert (contact.contact, contact.depth_max_mm, contact.objects, contact.x_mm) == (
        1,
        2.0,
        1,
        0.5,
    )
    assert (contact.shear_x_mm, contact.shear_y_mm, contact.fps) == (0.5, 0.25, 60.0)
    assert (value["left/event/slip"].x_mm, value["left/event/slip"].slip_mm_s) == (0.5, 9.0)
    named = value["left/event/object"]
    assert (named.name, named.probability, named.label) == ("nut_m8", 0.912, 1)
    assert (value["left/status/camera"].state, value["left/status/camera"].reason_code) == (
        "away",
        "lost",
    )
    assert (value["left/info"].version, value["left/info"].geometry.calibration_crc32) == ("1", CRC)
    assert (value["left/map/final"].folder, value["left/map/revision"].z_min_mm) == ("/s", None)
    assert value["hand/left/objects"].fingers["thumb"].reason_code == "lost"
    assert value["hand/left/health"].heard == {"thumb": 3}


@pytest.mark.parametrize("kind", ["wire", "hand", "touch"])
def test_every_vector_is_understood_or_refused(kind: str) -> None:
    for vector in VECTORS[kind]:
        payload = bytes.fromhex(vector["hex"]) if kind == "wire" else vector["payload"].encode()
        part = {
            "wire": vector.get("expect", {}).get("kind", "height"),
            "hand": "objects",
            "touch": "touch",
        }[kind]
        topic = f"tacshade/{'hand/left' if kind == 'hand' else 'left'}/{part}"
        if "error" in vector:
            with pytest.raises(tc.DecodeError):
                tc.decode_message(topic, payload)
        else:
            assert tc.decode_message(topic, payload).value.seq == vector["expect"].get("seq")


@pytest.mark.parametrize(
    "topic",
    [
        "",
        "tacshade",
        "tacshade/left",
        "tacshade/left/",
        "other/left/height",
        "tacshade/hand/height",
        "tacshade/left/heights",
        "tacshade/left/objects",
        "tacshade/hand/left/height",
        "tacshade/a b/height",
        "tacshade/" + 70 * "x" + "/height",
    ],
)
def test_a_topic_that_is_none_is_refused(topic: str) -> None:
    with pytest.raises(tc.DecodeError, match="topic "):
        tc.decode_message(topic, SENT["left/height"])


def test_a_new_topic_is_one_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(OF_SENSORS, "event/new", _json(SlipEvent))
    message = tc.decode_message("tacshade/left/event/new", SENT["left/event/slip"])
    assert isinstance(message.value, tc.SlipEvent)


@pytest.mark.parametrize(
    ("topic", "sent"), [("left/height", "left/cloud"), ("left/cloud", "left/height")]
)
def test_another_kind_of_payload_is_refused(topic: str, sent: str) -> None:
    with pytest.raises(tc.DecodeError, match="found a"):
        tc.decode_message(f"tacshade/{topic}", SENT[sent])


@given(
    st.sampled_from(sorted(SENT)),
    st.binary() | st.just(b""),
    st.integers(0, 200),
    st.binary(max_size=4),
)
def test_damaged_bytes_are_refused_or_understood(
    topic: str, other: bytes, at: int, put: bytes
) -> None:
    payload = SENT[topic]
    for damaged in (other, payload[:at], payload[:at] + put + payload[at + len(put) :]):
        refused = None
        try:
            tc.decode_message(f"tacshade/{topic}", damaged)
        except tc.DecodeError as error:
            refused = str(error)
        assert refused is None or (refused.isprintable() and len(refused) < 600)


def test_points_are_those_of_the_daemon() -> None:
    height = tc.decode(SENT["left/height"])
    geometry = tc.decode_info(SENT["left/info"]).geometry
    assert isinstance(height, tc.HeightMessage)
    assert geometry is not None
    known = calibration().geometry
    rays = disc_rays(Grid(*height.height_mm.shape, 0.0, 0.0, 4.0), known)
    np.testing.assert_array_equal(
        tc.skin_mm(height, geometry), core.skin_points(height.height_mm, rays, known)
    )
    other = tc.decode(binary.encode_height(PRESS, calibration_crc32=1))
    assert isinstance(other, tc.HeightMessage)
    with pytest.raises(tc.DecodeError, match="calibration 00000001, expected 1234abcd"):
        tc.skin_mm(other, geometry)
