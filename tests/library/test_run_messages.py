"""decode, decode_file and read_hand: the vectors of the wire, files of them,
and recordings of a hand's fingers.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import tacshade_edge as ts
from support.recordings import record_finger, record_hand
from tacshade_edge.wire.hand_messages import encode_hand

VECTORS = json.loads((Path(__file__).parents[1] / "wire" / "vectors" / "wire.json").read_text())
SOUND = [v for v in VECTORS if "expect" in v]
KINDS = {
    "height": ts.HeightMessage,
    "cloud": ts.CloudMessage,
    "shear": ts.ShearMessage,
    "sigma": ts.SigmaMessage,
}


@pytest.mark.parametrize("kind_of_bytes", [bytes, bytearray, memoryview])
def test_a_vector_is_what_its_header_says(kind_of_bytes: Any) -> None:
    for sound in SOUND:
        message = ts.decode(kind_of_bytes(bytes.fromhex(sound["hex"])))
        assert type(message) is KINDS[sound["expect"]["kind"]]
    with pytest.raises(ts.DecodeError, match="objects"):
        ts.decode(kind_of_bytes(b'{"fingers": 5}'))


def test_a_file_gives_its_messages_in_order(tmp_path: Path) -> None:
    payloads = [bytes.fromhex(v["hex"]) for v in SOUND]
    (path := tmp_path / "heights.bin").write_bytes(b"".join(payloads))
    found = list(ts.decode_file(path))
    assert [type(m) for m in found] == [KINDS[v["expect"]["kind"]] for v in SOUND]
    assert [m.seq for m in found] == [v["expect"]["seq"] for v in SOUND]
    path.write_bytes(b"")
    assert list(ts.decode_file(str(path))) == []


def test_a_damaged_file_gives_what_is_before(tmp_path: Path) -> None:
    first, second = (bytes.fromhex(v["hex"]) for v in SOUND[:2])
    (path := tmp_path / "heights.bin").write_bytes(
        first + second[:-1] + bytes([second[-1] ^ 1]) + first
    )
    messages = ts.decode_file(path)
    assert next(messages).seq == SOUND[0]["expect"]["seq"]
    with pytest.raises(ts.DecodeError, match=r"heights\.bin: message 1: .*CRC-32"):
        next(messages)
    path.write_bytes(first[:-1])
    with pytest.raises(
        ts.DecodeError, match=rf"heights\.bin: cut short after {len(first) - 1} bytes"
    ):
        list(ts.decode_file(path))
    path.write_bytes(first[:84] + b"\xff" * 4 + first[88:] + bytes(1000))
    with pytest.raises(
        ts.DecodeError, match=r"heights\.bin, byte 84: found 4294967295 payload bytes, expected at"
    ):
        list(ts.decode_file(path))
    with pytest.raises(ts.ConfigError, match=r"nothing\.bin: No such file"):
        list(ts.decode_file(tmp_path / "nothing.bin"))


def test_it_gives_what_the_hand_would_have_published(tmp_path: Path) -> None:
    made = list(ts.read_hand(record_hand(tmp_path)))
    assert list(made[0].fingers) == ["left-thumb", "left-index"]
    (touching, *_) = (m for m in made if all(f.state == "contact" for f in m.fingers.values()))
    thumb, index = touching.fingers.values()
    assert thumb.objects[0].centroid_mm[0] == pytest.approx(
        index.objects[0].centroid_mm[0] + 50.0, abs=0.01
    )
    assert touching.motion is not None
    assert touching.motion.translation_mm == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    assert ts.decode(encode_hand(touching)) == touching
    assert made[-1].motion is None


@pytest.mark.slow
def test_what_is_no_hand_is_refused(tmp_path: Path) -> None:
    thumb, index = record_hand(tmp_path)
    alone = record_finger(tmp_path / "alone", "sensor_id: alone\n")
    other = record_finger(
        tmp_path / "other", "{sensor_id: a, hand_id: right, hand_T_sensor: [0, 0, 0, 1, 0, 0, 0]}\n"
    )
    for paths, expected in (
        (
            (thumb, alone),
            (
                r"alone: found a recording without hand_T_sensor in its settings\.yaml, "
                r"expected a recording"
            ),
        ),
        (
            (thumb, other),
            "other: found recordings of the hands left, right, expected recordings of one hand",
        ),
        (
            (thumb, thumb),
            "found a second recording of left-thumb, expected one recording per finger",
        ),
        (str(index), "recordings: found .*, expected a list of paths"),
        ((), "recordings: found .*, expected a list of paths"),
    ):
        with pytest.raises(ts.ConfigError, match=expected):
            ts.read_hand(paths)
    (index / "calibration.npz").unlink()
    with pytest.raises(
        ts.ConfigError,
        match=r"left-index: found no calibration\.npz, expected one in each recording",
    ):
        ts.read_hand([thumb, index])
    with pytest.raises(ts.ConfigError, match="profile: found 'best', expected one of accurate"):
        ts.read_hand([thumb], profile="best")
