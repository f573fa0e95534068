from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.errors import ConfigError, DecodeError, DeviceError
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.protocol import wire
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.storage.runs.run_files import (
    CLOUDS,
    HEIGHTS,
    SHEARS,
    SUMMARY,
    TIMINGS,
    RunWriter,
    payloads,
    read_summary,
    summary,
)
from tacshade_edge.types import Frame, Pose, Reconstruction, Touch
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration

CRC32 = 0xABCD


def results() -> list[tuple[RecordedFrame, Reconstruction]]:
    reconstructor = make_reconstructor(painted_calibration(), PROFILES["fast"])
    pose = Pose(10, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)
    frames = [
        RecordedFrame("a.png", Frame(0, 5, 0, FREE)),
        RecordedFrame("b.png", Frame(2, 10, 0, TOUCHED, pose)),
    ]
    return [(recorded, reconstructor.step(recorded.frame)) for recorded in frames]


def write(folder: Path) -> RunWriter:
    writer = RunWriter(folder, calibration_crc32=CRC32)
    for recorded, result in results():
        writer.add(recorded, result)
    return writer


def test_a_run_is_the_wire_payloads_and_a_record_per_frame(tmp_path: Path) -> None:
    write(tmp_path / "new" / "run").finish({"seconds": 1.0})
    folder = tmp_path / "new" / "run"
    assert sorted(p.name for p in folder.iterdir()) == [CLOUDS, HEIGHTS, SHEARS, SUMMARY, TIMINGS]
    given = [(result, recorded.frame.pose) for recorded, result in results()]
    assert list(payloads(folder, HEIGHTS)) == [wire.encode_height(r, calibration_crc32=CRC32, pose=p) for r, p in given]
    assert list(payloads(folder, CLOUDS)) == [wire.encode_cloud(r, calibration_crc32=CRC32, pose=p) for r, p in given]
    assert list(payloads(folder, SHEARS)) == [wire.encode_shear(r, calibration_crc32=CRC32, pose=p) for r, p in given]
    free, touched = read_summary(folder)
    assert (free["image"], free["seq"], free["t_ns"], free["contact"], free["pose"]) == ("a.png", 0, 5, False, None)
    assert (touched["seq"], touched["contact"], touched["pose"]) == (2, True, [1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0])
    message = wire.decode(list(payloads(folder, HEIGHTS))[1])
    assert message.pose == given[1][1] is not None
    assert isinstance(message, wire.HeightMessage)
    assert touched["depth_max_mm"] == pytest.approx(np.nanmax(message.height_mm), abs=2e-3)
    assert json.loads((folder / "timings.json").read_text()) == {"seconds": 1.0}


def test_nothing_of_a_run_shows_before_it_is_whole(tmp_path: Path) -> None:
    write(tmp_path).finish({})
    second = write(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"{CLOUDS}.part", f"{HEIGHTS}.part", f"{SHEARS}.part"]
    with pytest.raises(ConfigError, match=r"summary\.json: No such file"):
        read_summary(tmp_path)
    second.discard()
    assert list(tmp_path.iterdir()) == []


def test_damage_is_told(tmp_path: Path) -> None:
    write(tmp_path).finish({})
    heights = tmp_path / HEIGHTS
    whole = heights.read_bytes()
    for size in (len(whole) - 1, 50):
        heights.write_bytes(whole[:size])
        with pytest.raises(DecodeError, match=rf"heights\.bin: cut short after {size} bytes"):
            list(payloads(tmp_path, HEIGHTS))
    for text, said in (
        ("{", "not valid JSON"),
        ("[1]", "found JSON of another form"),
        ("{}", "found JSON of another form"),
    ):
        (tmp_path / SUMMARY).write_text(text)
        with pytest.raises(DecodeError, match=said):
            read_summary(tmp_path)


def test_a_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "out").touch()
    with pytest.raises(DeviceError, match=r"out: cannot write it: File exists"):
        RunWriter(tmp_path / "out", calibration_crc32=0)


KEYS = ("touch", "touch_sigma", "touch_reason", "touch_reason_code")


def test_a_touch_is_numbers_with_their_deviations_and_why_one_is_missing() -> None:
    made = make_reconstructor(painted_calibration(), PROFILES["balanced"]).step(Frame(0, 0, 0, TOUCHED))
    record = summary(made)
    assert list(record["touch"]) == list(record["touch_sigma"])
    assert record["touch"]["depth_mm"] == record["depth_max_mm"] > 0
    assert record["touch_sigma"]["depth_mm"] > 0
    assert (record["touch_reason"], record["touch_reason_code"]) == ("", "")
    outside = Touch({"depth_mm": 1.23456, "force_z_n": None}, {"depth_mm": 0.01234, "force_z_n": None},
                    Reason(ReasonCode.TOUCH_RANGE, "outside"))  # fmt: skip
    record = summary(replace(made, touch=outside))
    assert [record[key] for key in KEYS] == [
        {"depth_mm": 1.2346, "force_z_n": None},
        {"depth_mm": 0.0123, "force_z_n": None},
        "outside",
        "touch_range",
    ]


def test_without_contact_there_is_no_touch() -> None:
    record = summary(make_reconstructor(painted_calibration(), PROFILES["fast"]).step(Frame(0, 0, 0, FREE)))
    assert [record[key] for key in KEYS] == [None, None, "", ""]
