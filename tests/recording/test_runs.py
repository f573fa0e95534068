from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from support.painted_sensor import FREE, TOUCHED, painted_calibration
from support.published_sensor import unmeasured
from tacshade_edge.errors import ConfigError, DecodeError, DeviceError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.recording import runs
from tacshade_edge.recording.recording import RecordedFrame
from tacshade_edge.recording.runs import (
    CLOUDS,
    HEIGHTS,
    SHEARS,
    SUMMARY,
    TIMINGS,
    RunWriter,
    figures,
    first_difference,
    payloads,
    read_summary,
    summary,
)
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import Frame, HeightMap, ObjectCloud, Pose, Reconstruction, Touch
from tacshade_edge.wire import binary

CRC32 = 0xABCD
Change = Callable[[Reconstruction], Reconstruction]


@cache
def results() -> tuple[tuple[RecordedFrame, Reconstruction], ...]:
    """A free and two touched frames, the last with a pose."""
    reconstructor = make_reconstructor(painted_calibration(), PROFILES["balanced"])
    pose = Pose(20, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)
    frames = [Frame(0, 0, 0, FREE), Frame(1, 10, 0, TOUCHED), Frame(2, 20, 0, TOUCHED, pose)]
    return tuple(
        (RecordedFrame(f"{frame.seq}.png", frame), reconstructor.step(frame)) for frame in frames
    )


def begun(folder: Path, change: Change = lambda result: result, frames: int = 3) -> RunWriter:
    """A run whose last frame is changed."""
    writer = RunWriter(folder, calibration_crc32=CRC32)
    for recorded, result in results()[:frames]:
        writer.add(recorded, change(result) if result.seq == 2 else result)
    return writer


def write(folder: Path, change: Change = lambda result: result, frames: int = 3) -> Path:
    begun(folder, change, frames).finish({"seconds": 1.0})
    return folder


def test_a_run_is_the_wire_payloads_and_a_record_per_frame(tmp_path: Path) -> None:
    folder = write(tmp_path / "new" / "run")
    assert sorted(p.name for p in folder.iterdir()) == [CLOUDS, HEIGHTS, SHEARS, SUMMARY, TIMINGS]
    for name, encode in (
        (HEIGHTS, binary.encode_height),
        (CLOUDS, binary.encode_cloud),
        (SHEARS, binary.encode_shear),
    ):
        expected = [
            encode(result, calibration_crc32=CRC32, pose=r.frame.pose) for r, result in results()
        ]
        assert list(payloads(folder, name)) == expected
    free, _, touched = read_summary(folder)
    assert (free["image"], free["seq"], free["t_ns"], free["contact"], free["pose"]) == (
        "0.png",
        0,
        0,
        False,
        None,
    )
    assert (touched["seq"], touched["contact"], touched["pose"]) == (
        2,
        True,
        [1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0],
    )
    message = binary.decode(list(payloads(folder, HEIGHTS))[2])
    assert isinstance(message, binary.HeightMessage)
    assert touched["depth_max_mm"] == pytest.approx(np.nanmax(message.height_mm), abs=2e-3)
    assert json.loads((folder / "timings.json").read_text()) == {"seconds": 1.0}


def test_a_summary_that_nobody_could_read_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = len(write(tmp_path / "whole", frames=2).joinpath(SUMMARY).read_bytes())
    monkeypatch.setattr(runs, "SUMMARY_BYTES_MAX", size)
    assert len(read_summary(write(tmp_path / "as-large", frames=2))) == 2
    more = begun(tmp_path / "more", frames=2)
    with pytest.raises(DeviceError, match=r"summary\.json: found more than 0 MiB after 2 frames"):
        more.add(*results()[2])
    more.discard()
    assert not list((tmp_path / "more").iterdir())


def test_nothing_of_a_run_shows_before_it_is_whole(tmp_path: Path) -> None:
    write(tmp_path)
    second = begun(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        f"{CLOUDS}.part",
        f"{HEIGHTS}.part",
        f"{SHEARS}.part",
    ]
    with pytest.raises(ConfigError, match=r"summary\.json: No such file"):
        read_summary(tmp_path)
    second.discard()
    assert list(tmp_path.iterdir()) == []


def test_damage_is_reported(tmp_path: Path) -> None:
    heights = write(tmp_path) / HEIGHTS
    whole = heights.read_bytes()
    for size in (len(whole) - 1, 50):
        heights.write_bytes(whole[:size])
        with pytest.raises(DecodeError, match=rf"heights\.bin: cut short after {size} bytes"):
            list(payloads(tmp_path, HEIGHTS))
    for text, said in (
        ("{", "not valid JSON"),
        ("[1]", "JSON of another form"),
        ("{}", "JSON of another form"),
    ):
        (tmp_path / SUMMARY).write_text(text)
        with pytest.raises(DecodeError, match=said):
            read_summary(tmp_path)
    with pytest.raises(
        DeviceError, match=r"heights\.bin: cannot write it: (File exists|Not a directory)"
    ):
        RunWriter(heights, calibration_crc32=0)


KEYS = ("touch", "touch_sigma", "touch_reason", "touch_reason_code")


def test_a_touch_is_numbers_with_their_deviations_and_why_one_is_missing() -> None:
    made = results()[1][1]
    record = summary(made)
    assert list(record["touch"]) == list(record["touch_sigma"])
    assert record["touch"]["depth_mm"] == record["depth_max_mm"] > 0
    assert record["touch_sigma"]["depth_mm"] > 0
    assert (record["touch_reason"], record["touch_reason_code"]) == ("", "")
    outside = Touch(
        {"depth_mm": 1.23456, "force_z_n": None},
        {"depth_mm": 0.01234, "force_z_n": None},
        Reason(ReasonCode.TOUCH_RANGE, "outside"),
    )
    record = summary(replace(made, touch=outside))
    assert [record[key] for key in KEYS] == [
        {"depth_mm": 1.2346, "force_z_n": None},
        {"depth_mm": 0.0123, "force_z_n": None},
        "outside",
        "touch_range",
    ]
    assert [summary(results()[0][1])[key] for key in KEYS] == [None, None, "", ""]


def deeper(result: Reconstruction) -> Reconstruction:
    height_mm = np.array(result.height.height_mm)
    height_mm[56, 50] += 0.25
    height = result.height
    return replace(
        result,
        height=HeightMap(height_mm, height.contact, height.row0, height.col0, height.step_px),
    )


def moved(result: Reconstruction) -> Reconstruction:
    points = np.array(result.cloud.points_mm)
    points[4, 2] += 1
    return replace(result, cloud=ObjectCloud(points, result.cloud.labels))


def test_equal_runs_differ_in_nothing(tmp_path: Path) -> None:
    assert first_difference(write(tmp_path / "run"), write(tmp_path / "again")) == ""


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: replace(r, t_ns=25), "frame 2 (2.png): t_ns: 20, against 25"),
        (
            lambda r: replace(r, valid=False, reason=Reason(ReasonCode.TORN, "torn")),
            "frame 2 (2.png): valid: True, against False",
        ),
        (lambda r: replace(r, wall_ns=3), "frame 2 (2.png): heights.bin: wall_ns: 0, against 3"),
        (lambda r: replace(r, objects=()), "frame 2 (2.png): depth_max_mm: "),
        (lambda r: replace(r, objects=(*r.objects, *r.objects)), "frame 2 (2.png): objects: "),
        (
            lambda r: replace(r, objects=(replace(r.objects[0], area_mm2=1.0), *r.objects[1:])),
            "frame 2 (2.png): objects: 0: area_mm2: ",
        ),
        (deeper, "frame 2 (2.png): heights.bin: height_mm: 1 of 12544 values differ"),
        (moved, "frame 2 (2.png): clouds.bin: points_mm: 1 of "),
    ],
)
def test_the_first_difference_is_named(tmp_path: Path, change: Change, said: str) -> None:
    found = first_difference(write(tmp_path / "run"), write(tmp_path / "other", change))
    assert found.startswith(said), found


def test_a_shorter_run_is_the_last_to_be_reported(tmp_path: Path) -> None:
    run, short = write(tmp_path / "run"), write(tmp_path / "short", frames=2)
    assert first_difference(run, short) == "frames: 3, against 2"
    assert first_difference(short, run) == "frames: 2, against 3"


def test_a_damaged_run_is_no_difference(tmp_path: Path) -> None:
    run, other = write(tmp_path / "run"), tmp_path / "other"
    shutil.copytree(run, other)
    heights = (other / HEIGHTS).read_bytes()
    (other / HEIGHTS).write_bytes(heights[: len(heights) // 3])
    with pytest.raises(DecodeError, match=r"heights\.bin: found 1 payloads, expected 3"):
        first_difference(run, other)
    flipped = bytearray(heights)
    flipped[200] ^= 1
    (other / HEIGHTS).write_bytes(flipped)
    with pytest.raises(DecodeError, match=r"CRC-32"):
        first_difference(run, other)
    with pytest.raises(ConfigError, match=r"none/summary\.json: No such file"):
        first_difference(run, tmp_path / "none")


def unknown(result: Reconstruction) -> Reconstruction:
    """The same frame as if something touched whose depth is unknown."""
    return replace(unmeasured(result.seq), t_ns=result.t_ns)


def test_a_touch_of_unknown_depth_has_no_depth_and_differs_from_no_contact(tmp_path: Path) -> None:
    record = summary(unmeasured(3))
    assert (record["contact"], record["touched"]) == (False, True)
    assert (record["depth_max_mm"], record["volume_mm3"]) == (None, None)
    assert record["degraded_code"] == "touch_unmeasured"
    one, other = write(tmp_path / "one"), write(tmp_path / "other", unknown)
    found = figures(one, other)
    assert found[0] == "contact: differs in 1 of 3 frames, first frame 2 (2.png)"
