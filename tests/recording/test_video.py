"""Videos: their own times at any rate, and what is said of one that ends early."""

from __future__ import annotations

import itertools
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.recordings import read_all
from tacshade_edge.camera.file_source import FilesSource
from tacshade_edge.errors import ConfigError
from tacshade_edge.recording.frame_table import T_NS_MAX
from tacshade_edge.recording.recording import Recording
from tacshade_edge.recording.video import Video

CONTAINERS = {"avi": "MJPG", "mp4": "mp4v", "mov": "mp4v", "mkv": "MJPG", "webm": "VP80"}
# Matroska states milliseconds.
ROUNDED_NS = {"mkv": 500_001, "webm": 500_001}
_number = itertools.count()


def written(folder: Path, container: str, fps: float, frames: int) -> Path:
    path = folder / f"{next(_number)}.{container}"
    code = cv2.VideoWriter_fourcc(*CONTAINERS[container])  # type: ignore[attr-defined]
    video = cv2.VideoWriter(str(path), code, fps, (64, 48))
    noise = np.random.default_rng(frames)
    for _ in range(frames):
        video.write(noise.integers(0, 255, (48, 64, 3)).astype(np.uint8))
    video.release()
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("videos")


rates = st.sampled_from([1.0, 5.0, 23.976, 25.0, 29.97, 30.0, 50.0, 60.0, 120.0, 240.0])


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(CONTAINERS)), rates, st.integers(1, 12))
def test_a_frame_has_the_time_of_its_video(
    folder: Path, container: str, fps: float, count: int
) -> None:
    path = written(folder, container, fps, count)
    frames, refused = read_all(Recording(path))
    assert refused == []
    expected_ns = [k * 1e9 / fps for k in range(count)]
    within_ns = ROUNDED_NS.get(container, 10_000)
    assert [f.frame.t_ns for f in frames] == pytest.approx(expected_ns, abs=within_ns)
    # Another rate overrules it.
    frames, _ = read_all(Recording(path, fps=10))
    assert [f.frame.t_ns for f in frames] == [k * 100_000_000 for k in range(count)]


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(CONTAINERS)), rates, st.floats(0.02, 0.999))
def test_a_video_that_ends_early_says_so(
    folder: Path, container: str, fps: float, part: float
) -> None:
    path = written(folder, container, fps, 12)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * part)])
    try:
        recording = Recording(path)
    except ConfigError:
        return  # not even a first frame
    frames, refused = read_all(recording)
    assert len(frames) <= 12
    if len(frames) < 12:
        assert refused == [
            f"{path}: the video ends after {len(frames)} of 12 frames, expected the whole file; "
            "its writer or its copy was cut off"
        ]


def test_a_video_without_its_index_says_what_is_missing(folder: Path) -> None:
    path = written(folder, "mp4", 30, 12)
    path.write_bytes(path.read_bytes()[:-700])
    with pytest.raises(ConfigError, match=r"without its index \(moov\), .* cut off; expected"):
        Recording(path)


@pytest.mark.parametrize("container", sorted(CONTAINERS))
def test_a_video_in_place_of_a_camera_keeps_its_pace(folder: Path, container: str) -> None:
    path = written(folder, container, 50, 5)
    for fps, period_ns in ((None, 20_000_000), (100.0, 10_000_000)):
        source = FilesSource(path=path, fps=fps, loop=True)
        source.open()
        times_ns = [frame.t_ns for _ in range(7) if (frame := source.read())]
        source.close()
        assert len(times_ns) == 7
        # Half of it: the first frame may be late, and a busy machine later still.
        assert times_ns[-1] - times_ns[0] > 3 * period_ns


def test_a_table_keeps_its_pace_too(tmp_path: Path) -> None:
    for k in range(2):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.zeros((48, 64), np.uint8))
    header = "image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz\n"
    times = "0.png,5,,,,,,,\n1.png,150000005,,,,,,,\n"
    (tmp_path / "frames.csv").write_text(header + times)
    source = FilesSource(path=tmp_path, fps=None, loop=False)
    source.open()
    first, second = source.read(), source.read()
    assert first is not None
    assert second is not None
    assert second.t_ns - first.t_ns > 145_000_000


def test_pictures_are_as_stored_whatever_way_up_a_video_is_to_be_shown(tmp_path: Path) -> None:
    path = written(tmp_path, "mp4", 25.0, 3)
    plain = [image for _, image in Video(path)]
    data = path.read_bytes()
    # The matrix of the track's header (ISO 14496-12, 8.3.2): a quarter turn, as phones write it.
    at = data.index(b"tkhd") + 44
    turn = struct.pack(">9i", 0, 1 << 16, 0, -1 << 16, 0, 0, 48 << 16, 0, 1 << 30)
    path.write_bytes(data[:at] + turn + data[at + len(turn) :])
    turned = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    assert turned.read()[1].shape == (64, 48, 3)
    for found, stored in zip(Video(path), plain, strict=True):
        np.testing.assert_array_equal(found[1], stored)


@pytest.mark.parametrize("rate", [(1, 2**32 - 1), (2**32 - 1, 1)])
def test_a_rate_that_no_camera_has_is_none(folder: Path, rate: tuple[int, int]) -> None:
    path = written(folder, "avi", 25.0, 8)
    data = path.read_bytes()
    at = data.index(b"strh") + 8 + 20  # the scale, and the rate of the stream
    path.write_bytes(data[:at] + struct.pack("<II", rate[1], rate[0]) + data[at + 8 :])
    frames, _ = read_all(Recording(path))
    times_ns = [each.frame.t_ns for each in frames]
    assert times_ns == sorted(set(times_ns))
    assert times_ns[-1] < T_NS_MAX
