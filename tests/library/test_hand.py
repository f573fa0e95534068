"""read_hand: recordings of the fingers of one hand."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.recorded_hand import record_finger, record_hand

import tacshade_edge as ts
from tacshade_edge.protocol.hand import encode_hand


def test_it_gives_what_the_hand_would_have_published(tmp_path: Path) -> None:
    made = list(ts.read_hand(record_hand(tmp_path)))
    assert list(made[0].fingers) == ["left-thumb", "left-index"]
    (touching, *_) = (m for m in made if all(f.state == "contact" for f in m.fingers.values()))
    thumb, index = touching.fingers.values()
    assert thumb.objects[0].centroid_mm[0] == pytest.approx(index.objects[0].centroid_mm[0] + 50.0, abs=0.01)
    assert touching.motion is not None
    assert touching.motion.translation_mm == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    assert ts.decode(encode_hand(touching)) == touching
    assert made[-1].motion is None


def test_what_is_no_hand_is_refused(tmp_path: Path) -> None:
    thumb, index = record_hand(tmp_path)
    alone = record_finger(tmp_path / "alone", "sensor_id: alone\n")
    other = record_finger(tmp_path / "other", "{sensor_id: a, hand_id: right, hand_T_sensor: [0, 0, 0, 1, 0, 0, 0]}\n")
    long = record_finger(tmp_path / "long", "{sensor_id: a, hand_id: left, hand_T_sensor: [0, 0, 0, 2, 0, 0, 0]}\n")
    for paths, expected in (
        (
            (thumb, alone),
            r"alone: found a recording without hand_T_sensor in its settings\.yaml, expected a recording of a hand",
        ),
        ((thumb, other), "other: found recordings of the hands left, right, expected recordings of one hand"),
        ((thumb, thumb), "found a second recording of left-thumb, expected one recording per finger"),
        ((long,), r"long: settings\.yaml: hand_T_sensor: found a quaternion of length 2, expected length 1"),
        (str(index), "recordings: found .*, expected a list of paths"),
        ((), "recordings: found .*, expected a list of paths"),
    ):
        with pytest.raises(ts.ConfigError, match=expected):
            ts.read_hand(paths)
    (index / "calibration.npz").unlink()
    with pytest.raises(ts.ConfigError, match=r"left-index: found no calibration\.npz, expected one in each recording"):
        ts.read_hand([thumb, index])
    with pytest.raises(ts.ConfigError, match="profile: found 'best', expected one of accurate"):
        ts.read_hand([thumb], profile="best")


def test_a_damaged_message_is_refused() -> None:
    with pytest.raises(ts.DecodeError, match="objects"):
        ts.decode(b'{"fingers": 5}')
