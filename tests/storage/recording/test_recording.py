from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from support.recordings import HEADER, write_recording

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.storage.recording.recording import RecordedFrame, Recording
from tacshade_edge.types import Pose


def picture(level: int) -> np.ndarray:
    return np.full((48, 64, 3), level, dtype=np.uint8)


def every(recording: Recording, most: int = 100) -> list[RecordedFrame]:
    frames: list[RecordedFrame] = []
    while len(frames) < most and (recorded := recording.read()) is not None:
        frames.append(recorded)
    return frames


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "rec", [picture(10 * k) for k in range(3)])


def test_it_is_wound_forward_without_reading_what_lies_between(folder: Path) -> None:
    (folder / "000000.png").write_bytes(b"no image")
    recording = Recording(folder)
    assert recording.length_ns == 20_000_000
    recording.skip_to(500 + 5_000_000)
    assert [recorded.frame.seq for recorded in every(recording)] == [1, 2]
    recording.skip_to(0)
    assert recording.read() is None


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "v.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25, (64, 48))
    assert writer.isOpened()
    for k in range(3):
        writer.write(picture(80 * k))
    writer.release()
    return path


def test_a_table_gives_order_times_and_poses(folder: Path) -> None:
    rows = (folder / "frames.csv").read_text().splitlines()[1:]
    names = [rows[2].split(",")[0], rows[0].split(",")[0]]
    (folder / "frames.csv").write_text(f"{HEADER}{names[0]},7,,,,,,,\n{names[1]},9,1,2,3,0.6,0,-0.8,0\n")
    first, second = every(Recording(folder))
    assert (first.name, first.frame.seq, first.frame.t_ns, first.frame.pose) == ("000002.png", 0, 7, None)
    assert first.frame.image[0, 0, 0] == 20
    assert (second.name, second.frame.seq, second.frame.wall_ns) == ("000000.png", 1, 0)
    assert second.frame.pose == Pose(9, 1.0, 2.0, 3.0, 0.6, 0.0, -0.8, 0.0)


def test_without_a_table_the_times_are_made(folder: Path) -> None:
    (folder / "frames.csv").unlink()
    times = [recorded.frame.t_ns for recorded in every(Recording(folder))]
    assert times == [0, 33_333_333, 66_666_667]
    assert [r.frame.t_ns for r in every(Recording(folder, fps=100))] == [0, 10_000_000, 20_000_000]


def test_a_loop_goes_on_in_number_and_time(folder: Path) -> None:
    frames = every(Recording(folder, times=2))
    assert [r.frame.seq for r in frames] == [0, 1, 2, 3, 4, 5]
    assert [r.frame.t_ns for r in frames] == [500 + k * 10_000_000 for k in range(6)]
    assert frames[4].name == frames[1].name
    assert len(every(Recording(folder, times=0), most=50)) == 50
    assert [r.frame.t_ns for r in every(Recording(folder / "000001.png", fps=10, times=3))] == [0, 10**8, 2 * 10**8]


def test_a_video_with_and_without_a_table(video: Path) -> None:
    plain = every(Recording(video, fps=50))
    assert [(r.name, r.frame.t_ns) for r in plain] == [("0", 0), ("1", 20_000_000), ("2", 40_000_000)]
    assert [round(float(r.frame.image.mean()) / 80) for r in plain] == [0, 1, 2]
    video.with_suffix(".csv").write_text(HEADER + "0,5,,,,,,,\n1,6,,,,,,,\n2,9,,,,,,,\n")
    assert [r.frame.t_ns for r in every(Recording(video))] == [5, 6, 9]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("0,5,,,,,,,\n1,6,,,,,,,\n", "found 2 rows, expected one row per video frame"),
        ("0,5,,,,,,,\n2,6,,,,,,,\n", "found frame '2' in row 2, expected one row per video frame"),
        ("".join(f"{k},{k},,,,,,,\n" for k in range(4)), "found 4 rows, expected 3 rows, one per video frame"),
    ],
)
def test_a_table_that_is_not_the_videos(video: Path, rows: str, said: str) -> None:
    video.with_suffix(".csv").write_text(HEADER + rows)
    with pytest.raises(ConfigError, match=said):
        every(Recording(video))


def test_an_image_that_cannot_be_read_leaves_a_gap(folder: Path) -> None:
    (folder / "000001.png").write_bytes(b"no image")
    recording = Recording(folder)
    assert recording.read() is not None
    with pytest.raises(DecodeError, match=r"000001\.png: found 8 bytes that are not an image"):
        recording.read()
    third = recording.read()
    assert third is not None
    assert (third.frame.seq, third.frame.t_ns) == (2, 20_000_500)
    assert recording.read() is None


def test_nothing_to_replay(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(ConfigError, match="found nothing, expected a folder"):
        Recording(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match="found no image"):
        Recording(tmp_path / "empty")
    with pytest.raises(ConfigError, match="found a file that OpenCV cannot read"):
        Recording(folder / "frames.csv")
    with pytest.raises(
        ConfigError, match=r"^--fps: found 20, expected no value, because .*frames\.csv contains the time stamps"
    ):
        Recording(folder, fps=20)
