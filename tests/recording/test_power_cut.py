"""What a power cut leaves of a recording: zero bytes and empty files where a file's end was not yet
on the disk.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.painted_sensor import painted_calibration
from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import EXIT_FAILED, EXIT_OK, main
from tacshade_edge.errors import ConfigError
from tacshade_edge.recording.frame_table import HEADER, MORE, line_crc32
from tacshade_edge.recording.recording import Recording

IMAGES = 10


def recorded(folder: Path, shape: tuple[int, int] = (4, 4)) -> Path:
    """A recording of `IMAGES` frames."""
    folder.mkdir()
    lines = [",".join((*HEADER, *MORE))]
    for k in range(IMAGES):
        cv2.imwrite(str(folder / f"{k:06d}.png"), np.full(shape, k, np.uint8))
        columns = f"{k:06d}.png,{k * 33_333_333},,,,,,,,"
        lines.append(f"{columns},{line_crc32(columns)}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    return folder


@given(st.integers(0, 2000), st.booleans(), st.sampled_from([1, 3, 100_000]))
def test_every_image_is_read_or_counted_as_lost(
    tmp_path_factory: pytest.TempPathFactory, cut: int, unfinished: bool, zeros: int
) -> None:
    folder = recorded(tmp_path_factory.mktemp("cut") / "r")
    table = folder / "frames.csv"
    data = table.read_bytes()
    begin = data.index(b"\n") + 1
    at = begin + cut % (len(data) - begin)
    if unfinished:
        table.unlink()
        table = folder / "frames.csv.part"
    table.write_bytes(data[:at] + bytes(zeros))
    if b"\n" not in data[begin:at]:
        with pytest.raises(ConfigError, match="found no rows"):
            Recording(folder)
        return
    recording = Recording(folder)
    assert recording.images + recording.lost == IMAGES
    assert f"no line names {recording.lost} of 10 images, which are lost" in recording.damage


def test_replay_counts_what_is_lost_and_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration = painted_calibration()
    size = calibration.image_height_px, calibration.image_width_px
    folder = recorded(tmp_path / "r", size)
    calibration_file.save(tmp_path / "c.npz", calibration)
    replay = ["replay", str(folder), "--calibration", str(tmp_path / "c.npz"), "--profile", "fast"]
    replay += ["--out", str(tmp_path / "out")]
    assert main(replay) == EXIT_OK
    assert "lost" not in capsys.readouterr().err
    table = folder / "frames.csv"
    data = table.read_bytes()
    end = len(data) * 6 // 10
    table.write_bytes(data[:end] + bytes(len(data) - end))
    assert main(replay) == EXIT_FAILED
    said = capsys.readouterr().err
    assert f"{table}:7: left out 1 damaged line and their frames, because found " in said
    assert "zero bytes, as after a power cut; no line names 5 of 10 images, which are lost" in said


def test_an_empty_calibration_is_named_where_it_lies(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "r")
    (folder / "calibration.npz").write_bytes(b"")
    with pytest.raises(ConfigError, match=rf"^{folder}/calibration\.npz: "):
        loading.of_recording(folder)
