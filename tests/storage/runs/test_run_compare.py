from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.storage.runs.run_compare import first_difference
from tacshade_edge.storage.runs.run_files import HEIGHTS, SUMMARY, RunWriter
from tacshade_edge.types import Frame, HeightMap, ObjectCloud, Reconstruction
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration

pytestmark = pytest.mark.slow

Change = Callable[[Reconstruction], Reconstruction]


def same(result: Reconstruction) -> Reconstruction:
    return result


def write(folder: Path, change: Change = same, frames: int = 3) -> Path:
    """A run of three frames, the last touched and changed."""
    reconstructor = make_reconstructor(painted_calibration(), PROFILES["balanced"])
    writer = RunWriter(folder, calibration_crc32=1)
    for seq, image in enumerate([FREE, TOUCHED, TOUCHED][:frames]):
        frame = Frame(seq, 10 * seq, 0, image)
        result = reconstructor.step(frame)
        writer.add(RecordedFrame(f"{seq}.png", frame), change(result) if seq == 2 else result)
    writer.finish({"seconds": float(frames)})
    return folder


def deeper(result: Reconstruction) -> Reconstruction:
    height_mm = np.array(result.height.height_mm)
    height_mm[56, 50] += 0.25
    height = result.height
    return replace(result, height=HeightMap(height_mm, height.contact, height.row0, height.col0, height.step_px))


def without_a_point(result: Reconstruction) -> Reconstruction:
    return replace(result, cloud=ObjectCloud(result.cloud.points_mm[1:], result.cloud.labels[1:]))


def moved(result: Reconstruction) -> Reconstruction:
    points = np.array(result.cloud.points_mm)
    points[4, 2] += 1
    return replace(result, cloud=ObjectCloud(points, result.cloud.labels))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return write(tmp_path / "run")


def test_equal_runs_differ_in_nothing(run: Path, tmp_path: Path) -> None:
    assert first_difference(run, write(tmp_path / "again")) == ""


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: replace(r, t_ns=25), "frame 2 (2.png): t_ns: 20, against 25 (by -5)"),
        (
            lambda r: replace(r, valid=False, reason=Reason(ReasonCode.TORN, "torn")),
            "frame 2 (2.png): valid: True, against False",
        ),
        (lambda r: replace(r, wall_ns=3), "frame 2 (2.png): heights.bin: wall_ns: 0, against 3 (by -3)"),
        (lambda r: replace(r, objects=()), "frame 2 (2.png): depth_max_mm: "),
        (lambda r: replace(r, objects=(*r.objects, *r.objects)), "frame 2 (2.png): objects: "),
        (
            lambda r: replace(r, objects=(replace(r.objects[0], area_mm2=1.0), *r.objects[1:])),
            "frame 2 (2.png): objects[0].area_mm2: ",
        ),
        (deeper, "frame 2 (2.png): heights.bin: height_mm: 1 of 12544 values differ, most at (56, 50): "),
        (moved, "frame 2 (2.png): clouds.bin: points_mm: 1 of "),
        (without_a_point, "frame 2 (2.png): clouds.bin: points_mm: shape ("),
    ],
)
def test_the_first_difference_is_named(run: Path, tmp_path: Path, change: Change, said: str) -> None:
    found = first_difference(run, write(tmp_path / "other", change))
    assert found.startswith(said), found


def test_a_shorter_run_is_the_last_to_be_told(run: Path, tmp_path: Path) -> None:
    assert first_difference(run, write(tmp_path / "short", frames=2)) == "frames: 3, against 2"
    assert first_difference(write(tmp_path / "short", frames=2), run) == "frames: 2, against 3"


def test_a_damaged_run_is_no_difference(run: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
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


def test_an_unknown_field_counts(run: Path, tmp_path: Path) -> None:
    other = write(tmp_path / "other")
    records: list[dict[str, Any]] = json.loads((other / SUMMARY).read_text())
    records[1]["glow"] = 2
    (other / SUMMARY).write_text(json.dumps(records))
    assert first_difference(run, other) == "frame 1 (1.png): glow: None, against 2"
